"""From `conf/` and KEY=VALUE to a checked, frozen config."""
