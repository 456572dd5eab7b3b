"""Camera frames of a moving object, rendered."""
