"""Runs as MLflow has stored them."""

from __future__ import annotations

from typing import Any

from pipelines.tracking.mlflow_store import client


def stored_run(run_id: str) -> Any:
    """MLflow's own record of a run."""
    return client().get_run(run_id)


def metric_history(run_id: str, name: str) -> list[tuple[int, float]]:
    """Steps and values of a run's metric."""
    return [(point.step, point.value) for point in client().get_metric_history(run_id, name)]
