"""Settings of `tossid.diagnose`, of its report and patch, and of a diagnosis over the order of recording."""
