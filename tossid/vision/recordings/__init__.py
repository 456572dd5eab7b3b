"""Recordings as they lie on disk: image folders, videos, ROS bags."""
