"""MLflow's client on its default store: quiet, sending nothing anywhere, safe for several processes.

The store is what MLflow itself would take (`mlflow.db` and `mlruns/` in the
working folder, or what MLFLOW_TRACKING_URI says), so that `mlflow ui` from the
same folder shows it with no further keys.
"""

from __future__ import annotations

import logging
import os
import sqlite3
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any
from urllib.parse import unquote

from pipelines.cli.console import Console
from pipelines.execution.process import environment
from pipelines.tracking.addresses import check_address, is_database, is_server, redacted, without_password
from tossid import budget
from tossid.errors import FileError, InputError
from tossid.locks import held
from tossid.outputs import output_file

if TYPE_CHECKING:
    from mlflow import MlflowClient

_HTTP = {"MAX_RETRIES": "2", "BACKOFF_FACTOR": "1", "TIMEOUT": "10"}
_CONNECT_S = 5
"""How long a database may take to answer [s]."""
_SQLITE = "sqlite:///"
_WAIT_MS = 60_000
"""How long a process waits until another one has written."""
_KIND = {"mlflow.experimentKind": "custom_model_development"}
"""What MLflow 3 opens an experiment as: training of models, and not language models.

The page of 3.17 goes by a switch of its own, which the browser remembers (docs/guide/train.md).
"""
_DAMAGED = "MLflow's store is damaged; move it away, and the next command makes a new one"
_ADVICE = "start it, or unset the variable to track in this folder"


@contextmanager
def at_once() -> Iterator[None]:
    """Notice within seconds that a server is away, while the block lasts; MLflow itself asks again for four minutes."""
    values = {f"MLFLOW_HTTP_REQUEST_{name}": value for name, value in _HTTP.items()}
    with environment({name: value for name, value in values.items() if name not in os.environ}):
        yield


def client() -> MlflowClient:
    """MLflow's client on its default store, quiet; the store is made by one process at a time.

    Raises:
        InputError: MLFLOW_TRACKING_URI names a server or database that does not answer or refuses.
        FileError: The store's file is damaged, or another version of MLflow made it.
    """
    os.environ.setdefault("MLFLOW_DISABLE_TELEMETRY", "true")
    os.environ.setdefault("GIT_PYTHON_REFRESH", "quiet")
    os.environ.setdefault("MLFLOW_SUPPRESS_PRINTING_URL_TO_STDOUT", "true")
    import mlflow
    from mlflow import MlflowClient

    for name in ("mlflow", "alembic"):
        logging.getLogger(name).setLevel(logging.CRITICAL)  # its errors are raised too, and reported here
    _let_sqlite_wait()
    uri = mlflow.get_tracking_uri()
    check_address(uri)
    if is_server(uri):
        return _answering(MlflowClient(uri), uri)
    if is_database(uri):
        _check_database(uri)
    if not uri.startswith(_SQLITE):
        return MlflowClient(uri)
    database = Path(unquote(uri.removeprefix(_SQLITE)))
    if not _is_made(database):
        _make(database)
    return _opened(uri, database)


def _opened(uri: str, database: Path) -> MlflowClient:
    """The client of a store in a file.

    Raises:
        FileError: The file is damaged, or another version of MLflow made it.
    """
    from mlflow import MlflowClient
    from mlflow.exceptions import MlflowException
    from sqlalchemy.exc import SQLAlchemyError

    budget.regular_size(database)
    try:  # MLflow would try a damaged file ten times, for 100 s
        with closing(sqlite3.connect(database)) as store:
            store.execute("SELECT count(*) FROM sqlite_master").fetchone()
    except sqlite3.OperationalError:  # another process holds it, or it may not be opened: MLflow waits, or says so
        pass
    except sqlite3.DatabaseError as error:
        raise FileError(database, _DAMAGED) from error
    try:
        client = MlflowClient(uri)
        client.search_experiments(max_results=1)
    except (MlflowException, SQLAlchemyError) as error:
        if "database schema" in str(error):
            said = f"another version of MLflow made this store; after a copy is made, 'mlflow db upgrade {uri}'"
            raise FileError(database, f"{said} brings it to this version's form") from error
        if "malformed" in str(error):  # (SQLite's word; MLflow wraps its errors)
            raise FileError(database, _DAMAGED) from error
        raise
    return client


def _answering(client: MlflowClient, uri: str) -> MlflowClient:
    """The client of a server, if that answers.

    Raises:
        InputError: It does not, or refuses.
    """
    from mlflow.exceptions import MlflowException

    try:
        with at_once():
            client.search_experiments(max_results=1)
    except MlflowException as error:
        code = error.get_http_status_code()
        if code < 500:
            first = redacted(str(error).partition("\n")[0])
            problem = f"the tracking server refuses ({first}); is it MLflow's, and are name and password right?"
        else:
            problem = f"the tracking server does not answer; {_ADVICE}"
        raise _refused(uri, problem) from error
    return client


def _check_database(uri: str) -> None:
    """Connect once: MLflow itself would try for half an hour.

    Raises:
        InputError: There is no such database, no answer, or no driver.
    """
    from sqlalchemy import create_engine
    from sqlalchemy.exc import SQLAlchemyError
    from sqlalchemy.pool import NullPool

    wait = {} if uri.startswith("mssql") else {"connect_timeout": _CONNECT_S}
    try:
        with create_engine(uri, poolclass=NullPool, connect_args=wait).connect():
            pass
    except ImportError as error:
        driver = "pip install 'tossid[server]', and write postgresql+psycopg2://"
        raise _refused(uri, f"the database's driver is not installed ({error}); {driver}") from error
    except (SQLAlchemyError, ValueError) as error:
        first = redacted(str(getattr(error, "orig", None) or error).partition("\n")[0])
        raise _refused(uri, f"the database does not answer ({first}); {_ADVICE}") from error


def _refused(uri: str, problem: str) -> InputError:
    return InputError(f"MLFLOW_TRACKING_URI={without_password(uri)}: {problem}")


def _let_sqlite_wait() -> None:
    """Let a process that finds the store locked wait for the other one, instead of failing."""
    from sqlalchemy import event
    from sqlalchemy.engine import Engine

    if not event.contains(Engine, "connect", _on_connect):
        event.listen(Engine, "connect", _on_connect)


def _on_connect(connection: Any, record: Any) -> None:
    if type(connection).__module__.startswith("sqlite3"):
        connection.execute(f"PRAGMA busy_timeout = {_WAIT_MS}")


def _make(database: Path) -> None:
    """Make the tables, whole or not at all: MLflow could not open a half-made store again."""
    from mlflow import MlflowClient
    from sqlalchemy import event
    from sqlalchemy.engine import Engine

    database.absolute().parent.mkdir(parents=True, exist_ok=True)
    with held(database.with_name(f".{database.name}.making"), wait=True):
        if not _is_made(database):  # by another process meanwhile
            event.listen(Engine, "connect", _unsynced)
            try:
                with output_file(database) as temporary:
                    MlflowClient(f"{_SQLITE}{temporary}").search_experiments(max_results=1)
            finally:
                event.remove(Engine, "connect", _unsynced)


def _unsynced(connection: Any, record: Any) -> None:
    connection.execute("PRAGMA synchronous = OFF")  # the file is synced once, when it is whole


def _is_made(database: Path) -> bool:
    return database.exists() and database.stat().st_size > 0


def find_experiment(client: MlflowClient, name: str) -> str | None:
    """The id of an experiment; one that was deleted in MLflow's page is restored with its runs, and a line says so.

    MLflow refuses to log to a deleted experiment, and to make another of its name.

    Args:
        client: MLflow's client.
        name: The experiment's name.

    Returns:
        The id; None if it is not there.
    """
    found = client.get_experiment_by_name(name)
    if found is None:
        return None
    if found.lifecycle_stage == "deleted":
        client.restore_experiment(found.experiment_id)
        Console().warn(f"experiment '{name}' had been deleted in MLflow; it is restored, with all of its runs")
    return str(found.experiment_id)


def experiment_id(client: MlflowClient, name: str) -> str:
    """The id of an experiment, made if it is not there, restored if it was deleted."""
    from mlflow.exceptions import MlflowException

    found = find_experiment(client, name)
    if found is not None:
        return found
    try:
        return str(client.create_experiment(name, tags=_KIND))
    except MlflowException:  # another process was faster
        found = find_experiment(client, name)
        if found is None:
            raise
        return found
