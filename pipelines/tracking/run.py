"""Logging to MLflow: runs with their config, code, data, metrics, figures and files.

Metrics are buffered: a run logs thousands of values in a few statements. A server that does not answer stops a command
before its work begins. Where it goes away during the work, MLflow asks again for four minutes; then the command ends,
and given again it goes on with what it has computed. MLflow is imported when the first run starts (1.5 s).
`pipelines.tracking.runs` finds runs again.
"""

from __future__ import annotations

import json
import os
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import is_dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pipelines.config.compose import as_plain, flatten
from pipelines.execution.code_version import commit, version
from pipelines.execution.process import interrupted_later
from pipelines.tracking.mlflow_store import at_once, client, experiment_id
from pipelines.tracking.runs import COMMAND_TAG, CONFIG, EXPERIMENT
from tossid.versions import computing_versions

if TYPE_CHECKING:
    from mlflow import MlflowClient

_BUFFER = 500
_PARAM_LENGTH = 6000
_DIGEST_LENGTH = 36


class TrackedRun:
    """A run that is going on. Made by `tracked_run`. resumed: it was begun earlier."""

    def __init__(self, client: MlflowClient, run_id: str, *, resumed: bool = False) -> None:
        self.id = run_id
        self.resumed = resumed
        self._client = client
        self._metrics: list[tuple[str, float, int, int]] = []

    def metrics(self, values: Mapping[str, float], *, step: int = 0) -> None:
        """Log values at a step. Buffered; a curve is one call a step."""
        now = int(time.time() * 1000)
        self._metrics += [(name, float(value), now, step) for name, value in values.items()]
        if len(self._metrics) >= _BUFFER:
            self.flush()

    def last_step(self) -> int:
        """The last step at which a metric was logged before this process went on with the run; 0 for a new one."""
        if not self.resumed:
            return 0
        names = self._client.get_run(self.id).data.metrics
        steps = [point.step for name in names for point in self._client.get_metric_history(self.id, name)]
        return max(steps, default=0)

    def flush(self) -> None:
        """Send the buffered metrics."""
        from mlflow.entities import Metric

        while self._metrics:
            self._client.log_batch(self.id, metrics=[Metric(*point) for point in self._metrics[:1000]])
            del self._metrics[:1000]

    def params(self, values: Mapping[str, Any]) -> None:
        """Log parameters (nested ones get dotted names)."""
        from mlflow.entities import Param

        params = [Param(name, _param(value)) for name, value in flatten(values).items()]
        for start in range(0, len(params), 100):
            self._client.log_batch(self.id, params=params[start : start + 100])

    def tag(self, name: str, value: object) -> None:
        """Set a tag."""
        self._client.set_tag(self.id, name, str(value))

    def describe(self, text: str, head: Sequence[str] = (), rows: Iterable[Sequence[str]] = ()) -> None:
        """Say what the run is and what it found, in Markdown and, where it has a head, a table: its page shows that."""
        lines = [f"| {' | '.join(cells)} |" for cells in (head, ["---"] * len(head), *rows)] if head else []
        self.tag("mlflow.note.content", "\n".join([text, "", *lines]))

    def data(self, path: Path, sha256: str, *, context: str) -> None:
        """Log a dataset that the run reads: which file, which hash, for what."""
        from mlflow.entities import Dataset, DatasetInput, InputTag

        source = json.dumps({"uri": os.path.abspath(path), "sha256": sha256})
        dataset = Dataset(Path(path).stem, sha256[:_DIGEST_LENGTH], "local", source)
        tags = {"mlflow.data.context": context, "sha256": sha256, "path": str(path)}
        given = DatasetInput(dataset, [InputTag(name, value) for name, value in tags.items()])
        self._client.log_inputs(self.id, [given])

    def artifact(self, path: Path, *, folder: str | None = None) -> None:
        """Copy a file (or a folder with its files) to the run's artifacts."""
        if path.is_dir():
            self._client.log_artifacts(self.id, str(path), folder or path.name)
        else:
            self._client.log_artifact(self.id, str(path), folder)

    def text(self, text: str, name: str) -> None:
        """Log a text (Markdown, YAML, JSON) as an artifact."""
        self._client.log_text(self.id, text, name)


@contextmanager
def tracked_run(
    name: str,
    config: Any,
    *,
    command: str,
    parent: TrackedRun | None = None,
    tags: Mapping[str, str] | None = None,
    resume: str | None = None,
) -> Iterator[TrackedRun]:
    """Log a run: its config at once, its end whatever the end is.

    Args:
        name: what a person calls it.
        config: a config dataclass, or a mapping: logged as `config.yaml` and, flattened, as parameters.
        command: what made it ("train"); `find_run` looks runs up by it.
        parent: the run that this one belongs to.
        tags: further tags.
        resume: id of a run that was left, to go on under it; where this store does not have it, a new one is begun.

    The run ends FINISHED, FAILED on an error, KILLED on Ctrl-C.
    """
    import yaml

    store = client()
    plain = as_plain(config) if is_dataclass(config) else dict(config)
    experiment = experiment_id(store, EXPERIMENT)  # first, since a deleted one is restored with its runs
    all_tags = {COMMAND_TAG: command, "tossid.version": version(), **(tags or {})}
    all_tags |= {f"version.{name}": value for name, value in computing_versions().items()}
    if commit():
        all_tags["mlflow.source.git.commit"] = commit()
    all_tags |= {"mlflow.source.name": f"tossid {command}", "mlflow.source.type": "LOCAL", "mlflow.user": _user()}
    if parent is not None:
        all_tags["mlflow.parentRunId"] = parent.id
    run = _left(store, resume)
    if run is None:
        run = TrackedRun(store, store.create_run(experiment, tags=all_tags, run_name=name).info.run_id)
    try:
        if not run.resumed:
            run.text(yaml.safe_dump(plain, sort_keys=False, allow_unicode=True), CONFIG)
            run.params(plain)
        yield run
        run.flush()
    except BaseException as error:
        status = "KILLED" if isinstance(error, (KeyboardInterrupt, GeneratorExit)) else "FAILED"
        # This error is the one to report, and a server that is lost is not waited for again.
        with interrupted_later(), at_once():
            with suppress(Exception):
                run.flush()
            with suppress(Exception):
                store.set_terminated(run.id, status)
        raise
    with interrupted_later():  # a run whose end is not logged is left as if it were running
        store.set_terminated(run.id, "FINISHED")


def _left(store: MlflowClient, run_id: str | None) -> TrackedRun | None:
    """A run that was left, running again; None where the store does not have it."""
    from mlflow.exceptions import MlflowException

    if run_id is None:
        return None
    try:
        if store.get_run(run_id).info.lifecycle_stage != "active":
            return None
        store.update_run(run_id, status="RUNNING")
    except MlflowException:
        return None
    return TrackedRun(store, run_id, resumed=True)


def _user() -> str:
    import getpass

    try:
        return getpass.getuser()
    except (OSError, KeyError, ImportError):
        return "unknown"


def _param(value: Any) -> str:
    text = json.dumps(value) if isinstance(value, (list, tuple, dict)) else "null" if value is None else str(value)
    return text[:_PARAM_LENGTH]
