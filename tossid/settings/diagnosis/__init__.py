"""Settings of `tossid.diagnose`, of its report and patch, of a diagnosis over the order of recording, and of audits."""
