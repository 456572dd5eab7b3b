"""Runs as they can be found again: the newest, by id, by name, by folder, by tag, under a parent."""

from __future__ import annotations

import atexit
import json
import os
import re
import tempfile
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any
from urllib.parse import unquote, urlparse

from pipelines.tracking.mlflow_store import client, find_experiment
from tossid.errors import FileError, InputError

if TYPE_CHECKING:
    from tossid.models import TrainedModel

EXPERIMENT = "tossid"
CHECKPOINT = "checkpoint.pt"
CONFIG = "config.yaml"
RUN = "run.json"
"""In a training's folder: {"run": MLflow's id}."""
TRAININGS = Path("outputs/train")
"""Folder of the trainings' folders, relative to the folder that a command is run in."""
COMMAND_TAG = "tossid.command"
_MOST_RUNS = 50_000
"""As many as MLflow gives at once."""
_COPIES = ExitStack()
"""Copies of what lies on a server, removed when the command ends."""
atexit.register(_COPIES.close)


@dataclass(frozen=True)
class RunRecord:
    """A run as it can be found again.

    Attributes:
        id: MLflow's run id; "" for a folder that names none.
        name: as MLflow has it.
        folder: where its artifacts lie on this machine.
        checkpoint: its checkpoint, None if it logged none, or its files are gone.
    """

    id: str
    name: str
    folder: Path
    checkpoint: Path | None

    def weights(self) -> Path:
        """Its checkpoint.

        Raises:
            InputError: It has none.
        """
        if self.checkpoint is not None:
            return self.checkpoint
        there = "has no checkpoint" if self.folder.is_dir() else f"has lost its files, there is no folder {self.folder}"
        raise InputError(f"run {self.name} ({self.id or self.folder}) {there}; run=NAME names another run, or a folder")

    def trained_model(self) -> TrainedModel:
        """The trained model that it keeps.

        Raises:
            InputError: It has no checkpoint, or that is damaged.
        """
        from tossid.models import TrainedModel

        return TrainedModel.load(self.weights())


def find_run(reference: str | Path | None = None, *, command: str = "train") -> RunRecord:
    """A run, by what a user gives for it.

    Args:
        reference: A run id (or an unambiguous beginning of at least 6 digits), a run's name (the newest of that
            name), a folder with `checkpoint.pt`, `models:/NAME/VERSION` of the registry, or None
            for the newest finished run of `command`.
        command: The command whose runs are searched.

    Returns:
        The run, with its checkpoint on this machine.

    Raises:
        InputError: There is no such run, or there are several.
        FileError: The folder is no run.
    """
    if str(reference).startswith("models:/"):
        return _registered(str(reference))
    if reference is not None and (Path(reference).is_dir() or os.sep in str(reference)):
        return _folder_record(Path(reference))
    text = None if reference is None else str(reference)

    def matches(*, deleted: bool) -> list[Any]:
        found = find_runs(command=command, finished=text is None, nested=text is not None, deleted=deleted)
        return found if text is None else _matching(found, text)

    here = matches(deleted=False)
    if here:
        return record_of(here[0])
    gone = matches(deleted=True)
    why = ""
    if gone:
        name, run_id = gone[0].info.run_name, gone[0].info.run_id
        why = f"run {name} was deleted in MLflow; 'mlflow runs restore --run-id {run_id}' brings it back"
    if text is None:
        raise InputError(f"there is no finished run{f' ({why})' if why else ' yet'}; make one with 'tossid {command}'")
    if why:
        raise InputError(f"run={text}: {why}")
    newest = find_runs(command=command, nested=True)[:3]
    known = ", ".join(f"{run.info.run_name} ({run.info.run_id[:8]})" for run in newest)
    raise InputError(f"run={text}: no such run of 'tossid {command}'; the newest are: {known or 'none'}")


def _matching(runs: list[Any], text: str) -> list[Any]:
    """The runs of an id, else of a name, else the one whose id begins so."""
    matches = [run for run in runs if run.info.run_id == text] or [run for run in runs if run.info.run_name == text]
    if not matches and len(text) >= 6:
        matches = [run for run in runs if run.info.run_id.startswith(text)]
        if len(matches) > 1:
            raise InputError(f"run={text}: fits {len(matches)} runs; give more of the id")
    return matches


def _registered(reference: str) -> RunRecord:
    """The run behind a model of the registry: models:/NAME/VERSION, models:/NAME/latest, models:/NAME@ALIAS."""
    from mlflow.exceptions import MlflowException

    parts = re.fullmatch(r"models:/([^/@]+)(?:@(.+)|/(latest|\d+))", reference)
    if parts is None:
        raise InputError(f"run={reference}: expected models:/NAME/VERSION, models:/NAME/latest or models:/NAME@ALIAS")
    (name, alias, version), store = parts.groups(), client()
    there = store.search_model_versions(f"name = '{name}'")
    try:
        if alias:
            found = store.get_model_version_by_alias(name, alias)
        elif version == "latest":
            found = max(there, key=lambda one: int(one.version))
        else:
            found = store.get_model_version(name, version)
    except (MlflowException, ValueError) as error:
        known = ", ".join(sorted((str(one.version) for one in there), key=int))
        raise InputError(f"run={reference}: no such model; versions of '{name}': {known or 'none'}") from error
    if not found.run_id:
        raise InputError(f"run={reference}: was not registered from a run")
    try:
        return record_of(store.get_run(found.run_id))
    except MlflowException as error:
        raise InputError(f"run={reference}: the run that it was made from is not in MLflow any more") from error


def find_runs(
    *,
    command: str | None = None,
    parent: str | None = None,
    finished: bool = False,
    nested: bool = False,
    deleted: bool = False,
) -> list[Any]:
    """MLflow runs, newest first: of a command, under a parent.

    Runs of a study (with a parent) are left out unless `parent` or `nested` asks for them. Runs that were deleted in
    MLflow are found by `deleted` alone.
    """
    from mlflow.entities import ViewType

    store = client()
    known = find_experiment(store, EXPERIMENT)
    if known is None:
        return []
    view = ViewType.DELETED_ONLY if deleted else ViewType.ACTIVE_ONLY
    wanted = {COMMAND_TAG: command} if command else {}
    if parent is not None:
        wanted["mlflow.parentRunId"] = parent
    terms = [f"tags.`{name}` = '{value}'" for name, value in wanted.items()]
    if finished:
        terms.append("attributes.status = 'FINISHED'")
    newest_first = ["attributes.start_time DESC"]
    found = store.search_runs([known], " and ".join(terms), view, max_results=_MOST_RUNS, order_by=newest_first)
    return [run for run in found if parent is not None or nested or "mlflow.parentRunId" not in run.data.tags]


def record_of(run: Any) -> RunRecord:
    """A `RunRecord` of what MLflow's client returned; its artifacts are fetched where they lie elsewhere."""
    folder = _artifacts(run)
    checkpoint = folder / CHECKPOINT
    return RunRecord(run.info.run_id, run.info.run_name, folder, checkpoint if checkpoint.is_file() else None)


def _artifacts(run: Any) -> Path:
    """The run's artifacts on this machine. Where they lie elsewhere, its checkpoint is copied."""
    uri = run.info.artifact_uri
    parts = urlparse(uri)
    if parts.scheme in ("", "file"):
        return Path(unquote(parts.path))
    store = client()
    there = {item.path for item in store.list_artifacts(run.info.run_id)}
    folder = _COPIES.enter_context(tempfile.TemporaryDirectory(prefix="tossid-run-"))
    if CHECKPOINT in there:
        store.download_artifacts(run.info.run_id, CHECKPOINT, folder)
    return Path(folder)


def _folder_record(folder: Path) -> RunRecord:
    checkpoint = folder / CHECKPOINT
    if not checkpoint.is_file():
        raise FileError(folder, f"is no run: expected a folder with {CHECKPOINT}")
    return RunRecord(run_id_in(folder) or "", folder.name, folder, checkpoint)


def run_id_in(folder: Path) -> str | None:
    """The run id that a training left in its folder."""
    try:
        return str(json.loads((folder / RUN).read_text())["run"])
    except (OSError, ValueError, KeyError, TypeError):
        return None
