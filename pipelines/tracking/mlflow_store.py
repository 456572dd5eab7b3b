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
from pipelines.tracking.addresses import check_address, is_database, is_server, redacted, without_password
from tossid import budget
from tossid.errors import FileError, InputError
from tossid.locks import held

if TYPE_CHECKING:
    from mlflow import MlflowClient

_HTTP = {"MAX_RETRIES": "2", "BACKOFF_FACTOR": "1", "TIMEOUT": "30"}
"""A server that is away is noticed within seconds, not within MLflow's four minutes."""
_HTTP_AT_ONCE = {"MAX_RETRIES": "0", "BACKOFF_FACTOR": "1", "TIMEOUT": "5"}
_CONNECT_S = 5
"""How long a database may take to answer [s]."""
_SQLITE = "sqlite:///"
LOCAL = f"{_SQLITE}mlflow.db"
"""MLflow's default store: a file in the folder that a command is run in."""
_NETWORK = (
    "nfs", "cifs", "smb", "lustre", "gpfs", "beegfs", "panfs", "ceph", "afs", "coda", "gfs2", "ocfs2", "9p", "vboxsf",
    "fuse",
)  # fmt: skip
"""How types of file systems begin that another machine may write to; what FUSE mounts may be local."""
_KIND = {"mlflow.experimentKind": "custom_model_development"}
"""What MLflow 3 opens an experiment as: training of models, and not language models.

The page of 3.17 goes by a switch of its own, which the browser remembers (docs/guide/train.md).
"""
_DAMAGED = "MLflow's store is damaged; move it away, and the next command makes a new one"
_ADVICE = "start it, or unset the variable to track in this folder"


def client(*, patient: bool = True) -> MlflowClient:
    """MLflow's client on its default store, quiet; the store is made by one process at a time.

    Args:
        patient: Whether a server is asked again when it does not answer.

    Raises:
        InputError: MLFLOW_TRACKING_URI names a server or database that does not answer or refuses.
        FileError: The store's file is damaged, or another version of MLflow made it.
    """
    os.environ.setdefault("MLFLOW_DISABLE_TELEMETRY", "true")
    os.environ.setdefault("GIT_PYTHON_REFRESH", "quiet")
    os.environ.setdefault("MLFLOW_SUPPRESS_PRINTING_URL_TO_STDOUT", "true")
    for name, value in (_HTTP if patient else _HTTP_AT_ONCE).items():
        os.environ.setdefault(f"MLFLOW_HTTP_REQUEST_{name}", value)
    for name in ("mlflow", "alembic"):
        logging.getLogger(name).setLevel(logging.CRITICAL)  # its errors are raised too, and reported here
    import mlflow
    from mlflow import MlflowClient

    for name in ("mlflow", "alembic"):
        logging.getLogger(name).setLevel(logging.CRITICAL)
    _prepare_sqlite()
    uri = mlflow.get_tracking_uri()
    check_address(uri)
    if is_server(uri):
        return _answering(MlflowClient(uri), uri)
    if is_database(uri):
        _check_database(uri)
    if uri.startswith(_SQLITE):
        return _in_file(uri)
    return MlflowClient(uri)


def local_client() -> MlflowClient:
    """MLflow's client on the store in this folder, whatever MLFLOW_TRACKING_URI says; after `client`."""
    return _in_file(LOCAL)


def _in_file(uri: str) -> MlflowClient:
    database = Path(unquote(uri.removeprefix(_SQLITE)))
    with _making(database):
        return _opened(uri, database)


def _opened(uri: str, database: Path) -> MlflowClient:
    """The client of a store in a file.

    Raises:
        FileError: The file is damaged, or another version of MLflow made it.
    """
    from mlflow import MlflowClient
    from mlflow.exceptions import MlflowException
    from sqlalchemy.exc import SQLAlchemyError

    if database.exists():
        budget.regular_size(database)
        _check_file(database)
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


def _check_file(database: Path) -> None:
    """See whether SQLite can read a store; MLflow would try it ten times, for 100 s.

    Raises:
        FileError: The file is damaged.
    """
    try:
        with closing(sqlite3.connect(database)) as store:
            store.execute("SELECT count(*) FROM sqlite_master").fetchone()
    except sqlite3.OperationalError:  # another process holds it, or it may not be opened: MLflow waits, or says so
        return
    except sqlite3.DatabaseError as error:
        raise FileError(database, _DAMAGED) from error


def is_remote(client: MlflowClient) -> bool:
    """Whether its store is a tracking server."""
    return is_server(str(client.tracking_uri))


def _answering(client: MlflowClient, uri: str) -> MlflowClient:
    """The client of a server, if that answers.

    Raises:
        InputError: It does not, or refuses.
    """
    from mlflow.exceptions import MlflowException

    try:
        client.search_experiments(max_results=1)
    except MlflowException as error:
        code = error.get_http_status_code()
        if code < 500:
            first = redacted(str(error).partition("\n")[0])
            problem = f"the tracking server refuses ({first}); is it MLflow's, and are name and password right?"
        else:
            problem = f"the tracking server does not answer; {_ADVICE}"
        raise InputError(f"MLFLOW_TRACKING_URI={without_password(uri)}: {problem}") from error
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
        problem = f"the database's driver is not installed ({error}); pip install 'tossid[server]', and write postgresql+psycopg2://"
        raise InputError(f"MLFLOW_TRACKING_URI={without_password(uri)}: {problem}") from error
    except (SQLAlchemyError, ValueError) as error:
        first = redacted(str(getattr(error, "orig", None) or error).partition("\n")[0])
        problem = f"the database does not answer ({first}); {_ADVICE}"
        raise InputError(f"MLFLOW_TRACKING_URI={without_password(uri)}: {problem}") from error


def network_file_system(path: Path) -> str | None:
    """The type of the network file system that a path lies on; None on a local one, and where no one says (not Linux).

    Args:
        path: A file or folder, which need not be there yet.
    """
    try:
        mounts = Path("/proc/self/mounts").read_text().splitlines()
    except OSError:
        return None
    path = Path(os.path.realpath(path))
    around = []
    for line in mounts:
        place, kind = line.split(" ")[1:3]
        place = place.replace("\\040", " ")  # as the kernel writes a space
        if path.is_relative_to(place):
            around.append((len(place), kind))
    kind = max(around, key=lambda one: one[0], default=(0, ""))[1]  # of two that are mounted at one place, either
    return kind if kind.startswith(_NETWORK) else None


def _prepare_sqlite() -> None:
    """Let several processes write: a write-ahead log where all are on one machine, and waiting instead of failing."""
    from sqlalchemy import event
    from sqlalchemy.engine import Engine

    if not event.contains(Engine, "connect", _on_connect):
        event.listen(Engine, "connect", _on_connect)


def _on_connect(connection: Any, record: Any) -> None:
    if type(connection).__module__.startswith("sqlite3"):
        cursor = connection.cursor()
        cursor.execute("PRAGMA busy_timeout = 60000")
        file = cursor.execute("PRAGMA database_list").fetchone()[2]
        # The write-ahead log is memory that processes of one machine share; a rollback journal is a file.
        shared = bool(file) and network_file_system(Path(file)) is not None
        cursor.execute(f"PRAGMA journal_mode = {'DELETE' if shared else 'WAL'}")
        cursor.execute(f"PRAGMA synchronous = {'FULL' if shared else 'NORMAL'}")
        cursor.close()


@contextmanager
def _making(database: Path) -> Iterator[None]:
    """Let one process make the tables, where they are not there yet, and leave no half of them.

    MLflow could not open a half-made store again. What an error or Ctrl-C leaves is removed. What a killed process left
    is put aside by the next one, which knows it by the file NAME.making.
    """
    making = database.with_suffix(".making")
    if _is_made(database) and not making.exists():
        yield
        return
    with held(database.with_name(f".{database.name}.lock"), wait=True):
        if making.exists():
            for path in _files(database):
                if path.exists():
                    os.replace(path, path.with_name(f"{path.name}.unfinished"))
        there = _is_made(database)  # by another process meanwhile
        if not there:
            making.touch()
        try:
            yield
        except BaseException:
            if not there:
                for path in _files(database):
                    path.unlink(missing_ok=True)
            raise
        finally:
            making.unlink(missing_ok=True)


def _is_made(database: Path) -> bool:
    return database.exists() and database.stat().st_size > 0


def _files(database: Path) -> list[Path]:
    """SQLite's files."""
    return [database.with_name(database.name + end) for end in ("", "-wal", "-shm", "-journal")]


def find_experiment(client: MlflowClient, name: str) -> str | None:
    """The id of an experiment; one that was deleted in MLflow's page is restored with its runs, and a line says so.

    MLflow refuses to log to a deleted experiment, and to make another of its name.

    Args:
        client: MLflow's client.
        name: The experiment's name.

    Returns:
        The id; None if it is not there.
    """
    from mlflow.exceptions import MlflowException

    found = client.get_experiment_by_name(name)
    if found is None:
        return None
    if found.lifecycle_stage == "deleted":
        try:
            client.restore_experiment(found.experiment_id)
        except MlflowException:  # another process was faster
            if client.get_experiment(found.experiment_id).lifecycle_stage == "deleted":
                raise
        Console().warn(f"experiment '{name}' had been deleted in MLflow; it is restored, with all of its runs")
    for tag, value in _KIND.items():
        if tag not in found.tags:  # an earlier version made it
            client.set_experiment_tag(found.experiment_id, tag, value)
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
