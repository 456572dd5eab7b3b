"""Runs in MLflow: logging, finding, the model registry."""
