"""MLflow's client on its default store: quiet, sending nothing anywhere, safe for several processes.

The store is what MLflow itself would take (`mlflow.db` and `mlruns/` in the
working folder, or what MLFLOW_TRACKING_URI says), so that `mlflow ui` from the
same folder shows it with no further keys.
"""

from __future__ import annotations

import fcntl
import logging
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any
from urllib.parse import unquote, urlsplit, urlunsplit

from tossid.errors import InputError

if TYPE_CHECKING:
    from mlflow import MlflowClient

_HTTP = {"MAX_RETRIES": "2", "BACKOFF_FACTOR": "1", "TIMEOUT": "30"}
"""A server that is away is noticed within seconds, not within MLflow's four minutes. Messages then wait on disk."""


def client() -> MlflowClient:
    """MLflow's client on its default store, quiet; the store is made by one process at a time."""
    os.environ.setdefault("MLFLOW_DISABLE_TELEMETRY", "true")
    os.environ.setdefault("GIT_PYTHON_REFRESH", "quiet")
    os.environ.setdefault("MLFLOW_SUPPRESS_PRINTING_URL_TO_STDOUT", "true")
    for name, value in _HTTP.items():
        os.environ.setdefault(f"MLFLOW_HTTP_REQUEST_{name}", value)
    for name in ("mlflow", "alembic"):
        logging.getLogger(name).setLevel(logging.CRITICAL)  # its errors are raised too, and reported here
    import mlflow
    from mlflow import MlflowClient

    for name in ("mlflow", "alembic"):
        logging.getLogger(name).setLevel(logging.CRITICAL)
    _prepare_sqlite()
    uri = mlflow.get_tracking_uri()
    if _is_server(uri):
        return _answering(MlflowClient(uri), uri)
    if uri.startswith("sqlite:///"):
        with _making(Path(unquote(uri.removeprefix("sqlite:///")))):
            client = MlflowClient(uri)
            client.search_experiments(max_results=1)
            return client
    return MlflowClient(uri)


def is_remote(client: MlflowClient) -> bool:
    """Whether its store is a tracking server."""
    return _is_server(str(client.tracking_uri))


def without_password(uri: str) -> str:
    """An address as it may be printed and stored: its password replaced by three asterisks."""
    parts = urlsplit(uri)
    if parts.password is None:
        return uri
    place = parts.netloc.rpartition("@")[2]
    return urlunsplit(parts._replace(netloc=f"{parts.username or ''}:***@{place}"))


def _is_server(uri: str) -> bool:
    return uri.startswith(("http://", "https://"))


def _answering(client: MlflowClient, uri: str) -> MlflowClient:
    """The client of a server, if that answers.

    Raises:
        InputError: it does not.
    """
    from mlflow.exceptions import MlflowException

    try:
        client.search_experiments(max_results=1)
    except MlflowException as error:
        if error.get_http_status_code() < 500:
            raise
        problem = "the tracking server does not answer; start it, or unset the variable to track in this folder"
        raise InputError(f"MLFLOW_TRACKING_URI={without_password(uri)}: {problem}") from error
    return client


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


_MAKING = b"making"


@contextmanager
def _making(database: Path) -> Iterator[None]:
    """Let one process make the tables, where they are not there yet, and leave no half of them.

    MLflow could not open a half-made store again. What an error or Ctrl-C
    leaves is removed; what a killed process left is put aside by the next one,
    which knows it by the lock file that says so.
    """
    lock = database.with_suffix(".making")
    while True:
        if database.exists() and database.stat().st_size > 0 and not lock.exists():
            yield
            return
        handle = os.open(lock, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o644)
        fcntl.flock(handle, fcntl.LOCK_EX)
        if _is_at(handle, lock):
            break
        os.close(handle)  # another process has made the store meanwhile
    try:
        if os.read(handle, len(_MAKING)) == _MAKING:
            for path in _files(database):
                if path.exists():
                    os.replace(path, path.with_name(f"{path.name}.unfinished"))
        there = database.exists() and database.stat().st_size > 0
        if not there:
            os.pwrite(handle, _MAKING, 0)
        try:
            yield
        except BaseException:
            if not there:
                for path in _files(database):
                    path.unlink(missing_ok=True)
            raise
    finally:
        lock.unlink(missing_ok=True)
        os.close(handle)


def _is_at(handle: int, path: Path) -> bool:
    """Whether an open file is still the one at a path."""
    try:
        return os.stat(path).st_ino == os.fstat(handle).st_ino
    except FileNotFoundError:
        return False


def _files(database: Path) -> tuple[Path, Path, Path]:
    """SQLite's files."""
    return database, database.with_name(f"{database.name}-wal"), database.with_name(f"{database.name}-shm")


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
