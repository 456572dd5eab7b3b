"""The changed simulator: edits of MJCF, and the patched model run in MuJoCo."""
