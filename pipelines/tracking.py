"""MLflow: runs with their config, code, data, metrics, figures and files; and how to find them again.

The store is MLflow's own default (`mlflow.db` and `mlruns/` in the working
folder, or what MLFLOW_TRACKING_URI says), so that `mlflow ui` from the same
folder shows it with no further keys. Metrics are buffered: a run logs
thousands of values in a few statements. MLflow is imported when the first run
starts, and told to be quiet and to send nothing anywhere.
"""

from __future__ import annotations

import json
import logging
import os
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field, is_dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any
from urllib.parse import unquote, urlparse

from pipelines.config import as_plain, flatten
from pipelines.version import commit, version
from tossid.errors import FileError, InputError

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from mlflow import MlflowClient

EXPERIMENT = "tossid"
CHECKPOINT = "checkpoint.pt"
CONFIG = "config.yaml"
COMMAND_TAG = "tossid.command"

_BUFFER = 500
_PARAM_LENGTH = 6000
_DIGEST_LENGTH = 36


@dataclass(frozen=True)
class DataUsed:
    """A dataset that a run read. context: "training", "evaluation", …"""

    path: str
    sha256: str
    context: str


@dataclass(frozen=True)
class RunRecord:
    """A run as it can be found again.

    Attributes:
        id: MLflow's run id; "" for a folder that names none.
        name, status: as MLflow has them.
        folder: where its artifacts lie on this machine.
        checkpoint: its checkpoint, None if it logged none.
        config: its resolved config.
        tags, params, metrics: as logged (the last value of each metric).
        data: the datasets that it read.
    """

    id: str
    name: str
    status: str
    folder: Path
    checkpoint: Path | None
    config: dict[str, Any]
    tags: dict[str, str] = field(default_factory=dict)
    params: dict[str, str] = field(default_factory=dict)
    metrics: dict[str, float] = field(default_factory=dict)
    data: tuple[DataUsed, ...] = ()


class TrackedRun:
    """A run that is going on. Made by `tracked_run`."""

    def __init__(self, client: MlflowClient, run_id: str, experiment: str, name: str) -> None:
        self.id = run_id
        self.experiment = experiment
        self.name = name
        self._client = client
        self._metrics: list[Any] = []

    def metrics(self, values: Mapping[str, float], *, step: int = 0) -> None:
        """Log values at a step. Buffered; a curve is one call a step."""
        from mlflow.entities import Metric

        now = int(time.time() * 1000)
        self._metrics += [Metric(name, float(value), now, step) for name, value in values.items()]
        if len(self._metrics) >= _BUFFER:
            self.flush()

    def flush(self) -> None:
        """Send the buffered metrics."""
        while self._metrics:
            batch = self._metrics[:1000]
            self._client.log_batch(self.id, metrics=batch)
            del self._metrics[: len(batch)]

    def params(self, values: Mapping[str, Any]) -> None:
        """Log parameters (nested ones get dotted names)."""
        from mlflow.entities import Param

        params = [Param(name, _param(value)) for name, value in flatten(values).items()]
        for start in range(0, len(params), 100):
            self._client.log_batch(self.id, params=params[start : start + 100])

    def tag(self, name: str, value: object) -> None:
        """Set a tag."""
        self._client.set_tag(self.id, name, value)

    def data(self, path: Path, sha256: str, *, context: str) -> None:
        """Log a dataset that the run reads: which file, which hash, for what."""
        from mlflow.entities import Dataset, DatasetInput, InputTag

        absolute = os.path.abspath(path)
        dataset = Dataset(
            name=Path(path).stem,
            digest=sha256[:_DIGEST_LENGTH],
            source_type="local",
            source=json.dumps({"uri": absolute, "sha256": sha256}),
        )
        tags = [InputTag("mlflow.data.context", context), InputTag("sha256", sha256), InputTag("path", str(path))]
        self._client.log_inputs(self.id, [DatasetInput(dataset, tags)])

    def figure(self, figure: Figure, name: str) -> None:
        """Log a matplotlib figure as `figures/NAME.png`."""
        self._client.log_figure(self.id, figure, f"figures/{Path(name).stem}.png")

    def artifact(self, path: Path, *, folder: str | None = None) -> None:
        """Copy a file (or a folder with its files) to the run's artifacts."""
        if path.is_dir():
            self._client.log_artifacts(self.id, str(path), folder or path.name)
        else:
            self._client.log_artifact(self.id, str(path), folder)

    def checkpoint(self, path: Path) -> None:
        """Copy the run's checkpoint to its artifacts, under the name that `find_run` looks for."""
        if path.name != CHECKPOINT:
            raise ValueError(f"a checkpoint is named {CHECKPOINT}, not {path.name}")
        self._client.log_artifact(self.id, str(path))

    def text(self, text: str, name: str) -> None:
        """Log a text (Markdown, YAML, JSON) as an artifact."""
        self._client.log_text(self.id, text, name)

    def record(self) -> RunRecord:
        """The run as `find_run` would return it now."""
        self.flush()
        return _record(self._client.get_run(self.id))


@contextmanager
def tracked_run(
    name: str,
    config: Any,
    *,
    command: str,
    experiment: str = EXPERIMENT,
    parent: TrackedRun | str | None = None,
    tags: Mapping[str, str] | None = None,
) -> Iterator[TrackedRun]:
    """Log a run: its config at once, its end whatever the end is.

    Args:
        name: what a person calls it.
        config: a config dataclass, or a mapping: logged as `config.yaml` and, flattened, as parameters.
        command: what made it ("train"); `find_run` looks runs up by it.
        experiment: MLflow experiment.
        parent: the run (or its id) that this one belongs to.
        tags: further tags.

    The run ends FINISHED, FAILED on an error, KILLED on Ctrl-C.
    """
    import yaml

    client = _client()
    plain = as_plain(config) if is_dataclass(config) else dict(config)
    all_tags = {COMMAND_TAG: command, "tossid.version": version(), **(tags or {})}
    if commit():
        all_tags["mlflow.source.git.commit"] = commit()
    all_tags |= {"mlflow.source.name": f"tossid {command}", "mlflow.source.type": "LOCAL", "mlflow.user": _user()}
    if parent is not None:
        all_tags["mlflow.parentRunId"] = parent.id if isinstance(parent, TrackedRun) else parent
    created = client.create_run(_experiment(client, experiment), tags=all_tags, run_name=name)
    run = TrackedRun(client, created.info.run_id, experiment, name)
    status = "FAILED"
    try:
        run.text(yaml.safe_dump(plain, sort_keys=False, allow_unicode=True), CONFIG)
        run.params(plain)
        yield run
        run.flush()
        status = "FINISHED"
    except (KeyboardInterrupt, GeneratorExit):
        status = "KILLED"
        raise
    finally:
        if status != "FINISHED":
            with suppress(Exception):  # the first error is the one to report
                run.flush()
        client.set_terminated(run.id, status)


def resumed_run(run_id: str) -> TrackedRun:
    """A run that was left (interrupted training, say), going on under its id. End it with `end_run`."""
    client = _client()
    record = client.get_run(run_id)
    client.update_run(run_id, status="RUNNING")
    experiment = client.get_experiment(record.info.experiment_id).name
    return TrackedRun(client, run_id, experiment, record.info.run_name)


def end_run(run: TrackedRun, status: str = "FINISHED") -> None:
    """End a run that `resumed_run` reopened: FINISHED, FAILED or KILLED."""
    run.flush()
    _client().set_terminated(run.id, status)


def find_run(reference: str | Path | None = None, *, command: str = "train", experiment: str = EXPERIMENT) -> RunRecord:
    """A run, by what a user gives for it.

    Args:
        reference: a run id (or an unambiguous beginning of at least 6 digits), a
            run's name (the newest of that name), a folder with `checkpoint.pt` and `config.yaml`, or None for
            the newest finished run of `command`.
        command: which command's runs are meant.

    Raises:
        InputError: there is no such run, or several.
        FileError: the folder is no run.
    """
    if reference is not None and (Path(reference).is_dir() or os.sep in str(reference)):
        return _folder_record(Path(reference))
    found = find_runs(command=command, experiment=experiment, finished=reference is None, nested=reference is not None)
    if reference is None:
        if not found:
            raise InputError(f"there is no finished run yet; make one with 'tossid {command}'")
        return _record(found[0])
    text = str(reference)
    matches = [run for run in found if run.info.run_id == text] or [run for run in found if run.info.run_name == text]
    if not matches and len(text) >= 6:
        matches = [run for run in found if run.info.run_id.startswith(text)]
        if len(matches) > 1:
            raise InputError(f"run={text}: fits {len(matches)} runs; give more of the id")
    if not matches:
        known = ", ".join(f"{run.info.run_name} ({run.info.run_id[:8]})" for run in found[:3])
        raise InputError(f"run={text}: no such run of 'tossid {command}'; the newest are: {known or 'none'}")
    return _record(matches[0])


def find_runs(
    *,
    command: str | None = None,
    experiment: str = EXPERIMENT,
    parent: str | None = None,
    tags: Mapping[str, str] | None = None,
    finished: bool = False,
    nested: bool = False,
) -> list[Any]:
    """MLflow runs, newest first: of a command, under a parent, with tags.

    Runs of a study (with a parent) are left out unless `parent` or `nested` asks for them.
    """
    client = _client()
    known = client.get_experiment_by_name(experiment)
    if known is None:
        return []
    wanted = {**({COMMAND_TAG: command} if command else {}), **(tags or {})}
    if parent is not None:
        wanted["mlflow.parentRunId"] = parent
    terms = [f"tags.`{name}` = '{value}'" for name, value in wanted.items()]
    if finished:
        terms.append("attributes.status = 'FINISHED'")
    runs: list[Any] = []
    token: str | None = None
    while True:
        page = client.search_runs(
            [known.experiment_id], " and ".join(terms), order_by=["attributes.start_time DESC"], page_token=token
        )
        runs += [run for run in page if parent is not None or nested or "mlflow.parentRunId" not in run.data.tags]
        token = page.token
        if not token:
            return runs


def metric_history(run_id: str, name: str) -> list[tuple[int, float]]:
    """Steps and values of a run's metric."""
    return [(point.step, point.value) for point in _client().get_metric_history(run_id, name)]


# ---------------------------------------------------------------- behind


def _client() -> MlflowClient:
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


def _experiment(client: MlflowClient, name: str) -> str:
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


def _user() -> str:
    import getpass

    try:
        return getpass.getuser()
    except (OSError, KeyError, ImportError):
        return "unknown"


def _param(value: Any) -> str:
    text = json.dumps(value) if isinstance(value, (list, tuple, dict)) else "null" if value is None else str(value)
    return text[:_PARAM_LENGTH]


def _record(run: Any) -> RunRecord:
    import yaml

    folder = _artifacts(run)
    checkpoint, config = folder / CHECKPOINT, folder / CONFIG
    return RunRecord(
        id=run.info.run_id,
        name=run.info.run_name,
        status=run.info.status,
        folder=folder,
        checkpoint=checkpoint if checkpoint.is_file() else None,
        config=yaml.safe_load(config.read_text()) if config.is_file() else {},
        tags=dict(run.data.tags),
        params=dict(run.data.params),
        metrics=dict(run.data.metrics),
        data=tuple(_data_used(entry) for entry in run.inputs.dataset_inputs),
    )


def _data_used(entry: Any) -> DataUsed:
    tags = {tag.key: tag.value for tag in entry.tags}
    source = json.loads(entry.dataset.source)
    return DataUsed(
        path=source.get("uri", ""),
        sha256=tags.get("sha256", entry.dataset.digest),
        context=tags.get("mlflow.data.context", ""),
    )


def _artifacts(run: Any) -> Path:
    """The run's artifacts on this machine; downloaded where they lie elsewhere."""
    uri = run.info.artifact_uri
    parts = urlparse(uri)
    if parts.scheme in ("", "file"):
        return Path(unquote(parts.path))
    from mlflow.artifacts import download_artifacts

    return Path(download_artifacts(artifact_uri=uri))


def _folder_record(folder: Path) -> RunRecord:
    import yaml

    checkpoint = folder / CHECKPOINT
    if not checkpoint.is_file():
        raise FileError(folder, f"is no run: expected a folder with {CHECKPOINT} and {CONFIG}")
    try:
        config = yaml.safe_load((folder / CONFIG).read_text())
    except (OSError, yaml.YAMLError, UnicodeDecodeError) as error:
        raise FileError(folder / CONFIG, "cannot be read as YAML") from error
    if not isinstance(config, dict):
        raise FileError(folder / CONFIG, "holds no config")
    return RunRecord("", folder.name, "FINISHED", folder, checkpoint, config)
