"""Files of a project: outputs, datasets, checkpoints, sources."""
