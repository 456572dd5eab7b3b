"""MLflow's client on its default store: quiet, sending nothing anywhere, safe for several processes.

The store is what MLflow itself would take (`mlflow.db` and `mlruns/` in the
working folder, or what MLFLOW_TRACKING_URI says), so that `mlflow ui` from the
same folder shows it with no further keys.
"""

from __future__ import annotations

import logging
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any
from urllib.parse import unquote

if TYPE_CHECKING:
    from mlflow import MlflowClient


def client() -> MlflowClient:
    """MLflow's client on its default store, quiet; the store is made by one process at a time."""
    os.environ.setdefault("MLFLOW_DISABLE_TELEMETRY", "true")
    os.environ.setdefault("GIT_PYTHON_REFRESH", "quiet")
    for name in ("mlflow", "alembic"):
        logging.getLogger(name).setLevel(logging.WARNING)
    import mlflow
    from mlflow import MlflowClient

    for name in ("mlflow", "alembic"):
        logging.getLogger(name).setLevel(logging.WARNING)
    _prepare_sqlite()
    uri = mlflow.get_tracking_uri()
    if uri.startswith("sqlite:///"):
        with _making(Path(unquote(uri.removeprefix("sqlite:///")))):
            client = MlflowClient(uri)
            client.search_experiments(max_results=1)
            return client
    return MlflowClient(uri)


def _prepare_sqlite() -> None:
    """Let several processes write: a write-ahead log, and waiting instead of failing."""
    from sqlalchemy import event
    from sqlalchemy.engine import Engine

    if not event.contains(Engine, "connect", _on_connect):
        event.listen(Engine, "connect", _on_connect)


def _on_connect(connection: Any, record: Any) -> None:
    if type(connection).__module__.startswith("sqlite3"):
        cursor = connection.cursor()
        cursor.execute("PRAGMA busy_timeout = 60000")
        cursor.execute("PRAGMA journal_mode = WAL")
        cursor.execute("PRAGMA synchronous = NORMAL")
        cursor.close()


@contextmanager
def _making(database: Path) -> Iterator[None]:
    """Hold back others while the first process makes the tables (only where the file is not there yet)."""
    if database.exists() and database.stat().st_size > 0 and not database.with_suffix(".making").exists():
        yield
        return
    import fcntl

    lock = database.with_suffix(".making")
    with open(lock, "w") as handle:
        fcntl.flock(handle, fcntl.LOCK_EX)
        try:
            yield
        finally:
            lock.unlink(missing_ok=True)


def experiment_id(client: MlflowClient, name: str) -> str:
    """The id of an experiment, made if it is not there."""
    from mlflow.exceptions import MlflowException

    found = client.get_experiment_by_name(name)
    if found is not None:
        return str(found.experiment_id)
    try:
        return str(client.create_experiment(name))
    except MlflowException:  # another process was faster
        found = client.get_experiment_by_name(name)
        if found is None:
            raise
        return str(found.experiment_id)
