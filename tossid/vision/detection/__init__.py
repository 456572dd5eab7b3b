"""From frames to tag corners with their covariances."""
