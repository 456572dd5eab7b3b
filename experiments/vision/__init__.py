"""Experiments with trackers, films and recordings of tags."""
