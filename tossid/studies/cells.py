"""Cells of a study: which there are, what identifies them, how one is computed, and where it is kept."""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields, is_dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from tossid.code_digest import code_digest
from tossid.errors import ConfigError, FileError
from tossid.evaluation.evaluate import evaluate
from tossid.models import variant
from tossid.models.trained import checkpoint_bytes
from tossid.outputs import write_whole
from tossid.plain_json import digest_of, jsonable
from tossid.settings.changed import changed
from tossid.settings.training import ModelSettings, TrainSettings
from tossid.store import Dataset, file_sha256, read_dataset
from tossid.training.api import train

SCHEMA = "tossid.cell/1"
CELL, CHECKPOINT, CONFIG = "cell.json", "checkpoint.pt", "config.yaml"
"""Names of a cell's files: its numbers, its model, its settings."""


@dataclass(frozen=True)
class StudyCell:
    """One training and its evaluation.

    Attributes:
        model: What the study calls the model.
        seed: Of the training.
        swept: What the swept setting is called: "gravity".
        value: Of the swept setting.
        settings: Of the training, with the seed and the value.
        digest: Of all that its numbers depend on: settings, data, code.
        keys: Plain values that are written beside its checkpoint.
    """

    model: str
    seed: int
    swept: str
    value: float
    settings: TrainSettings
    digest: str
    keys: Mapping[str, Any] = field(compare=False, repr=False)

    @property
    def name(self) -> str:
        """Its folder's name."""
        model = re.sub(r"[^\w.=-]+", "-", self.model)
        return f"{model}-{self.value:g}-s{self.seed}-{self.digest[:12]}"

    @property
    def label(self) -> dict[str, Any]:
        """Its model, seed and swept value, by name."""
        return {"model": self.model, "seed": self.seed, self.swept: self.value}


@dataclass(frozen=True)
class StudyData:
    """The tosses of a study, as workers get them.

    Attributes:
        dataset: With the splits train, validation and test; None where workers read the file.
        path: Its file, None for a dataset in memory.
        sha256: Of the file, or of what is in memory.
    """

    dataset: Dataset | None = field(repr=False)
    path: Path | None
    sha256: str

    @classmethod
    def of(cls, data: str | Path | Dataset) -> StudyData:
        """The tosses of a dataset in memory, or of a file, which every worker reads for itself.

        Raises:
            FileError: The file is no dataset.
        """
        if isinstance(data, Dataset):
            return cls(data, None, memory_sha256(data))
        return cls(None, Path(data).absolute(), file_sha256(Path(data)))

    def read(self) -> Dataset:
        """The dataset.

        Raises:
            FileError: The file has changed since.
        """
        if self.dataset is not None:
            return self.dataset
        assert self.path is not None
        return _read(self.path, self.sha256)


@lru_cache(maxsize=1)
def _read(path: Path, sha256: str) -> Dataset:
    """A worker's dataset."""
    if file_sha256(path) != sha256:
        raise FileError(path, "is not the file that the study began with; its workers must see the same one there")
    return read_dataset(path)


@dataclass(frozen=True)
class CellResult:
    """What a cell gave.

    Attributes:
        scores: Metrics and parameters as of `Scores.as_json()`, the number of epochs and the seconds of the training.
        history: Epoch records.
        checkpoint: The model's file, or its content.
    """

    scores: dict[str, Any]
    history: list[dict[str, Any]]
    checkpoint: bytes | Path = field(repr=False)


def study_cells(
    data: StudyData,
    *,
    key: str,
    values: Sequence[float],
    models: Sequence[str] | Mapping[str, str | ModelSettings] = ("cnrpi",),
    seeds: Sequence[int] = (0,),
    settings: TrainSettings = TrainSettings(),
) -> tuple[StudyCell, ...]:
    """The cells of a study, in the order models, values, seeds.

    Args:
        data: What is learned from.
        key: The setting of `TrainSettings` that is swept, by name: "gravity", "tosses", "model.start_inertia".
        values: Its values.
        models: Variants by name; or by a name of one's own, each a variant or its settings.
        seeds: Of the trainings.
        settings: All else of the trainings.

    Raises:
        ConfigError: Nothing is swept, a value stands twice, or the key is no setting or out of range.
    """
    named = models if isinstance(models, Mapping) else {name: name for name in models}
    for name, given in (("values", values), ("models", models), ("seeds", seeds)):
        if not len(given):
            raise ConfigError(name, "is empty; a study needs at least one.")
        if len(set(given)) < len(given):
            raise ConfigError(name, "names one twice.")
    cells = []
    for name, model in named.items():
        of_model = replace(settings, model=variant(model) if isinstance(model, str) else model)
        for value in values:
            number = int(value) if float(value).is_integer() else value
            for seed in seeds:
                cells.append(study_cell(name, key, value, changed(of_model, {key: number, "seed": seed}), data.sha256))
    return tuple(cells)


def study_cell(
    model: str, key: str, value: float, settings: TrainSettings, sha256: str, *, keys: Mapping[str, Any] | None = None
) -> StudyCell:
    """A cell with its digest.

    Args:
        model: What the study calls the model.
        key: The setting that is swept.
        value: Its value.
        settings: Of the training.
        sha256: Of the data.
        keys: What is written beside its checkpoint; None for the settings.
    """
    alone = replace(settings, threads=1)  # which changes no number
    digest = digest_of([SCHEMA, asdict(alone), sha256, code_digest()])
    written = jsonable(asdict(settings)) if keys is None else keys
    return StudyCell(model, settings.seed, key.rpartition(".")[2], value, alone, digest, written)


def compute_cell(cell: StudyCell, data: StudyData) -> CellResult:
    """Train on the training tosses, evaluate on the test tosses, in one thread.

    Raises:
        FileError: The data's file is not the one that the study began with.
        DivergedError: The loss became NaN or infinite.
    """
    dataset = data.read()
    trained = train(dataset, settings=cell.settings)
    scores = evaluate(trained, dataset.split("test")).as_json()
    del scores["model"]  # a cell has a longer name
    scores |= {"epochs": len(trained.history), "seconds": trained.seconds}
    kept = replace(trained, data=data.path, sha256=data.sha256)
    return CellResult(scores, [asdict(record) for record in trained.history], checkpoint_bytes(kept))


def find_cell(cell: StudyCell, folder: Path) -> CellResult | None:
    """A cell that a study in a folder, or in one beside it, has computed from the same settings, data and code.

    None where it is not there, or not whole.
    """
    for path in sorted(folder.parent.glob(f"*/cells/{cell.name}/{CELL}")):
        try:
            found = json.loads(path.read_text())
        except (OSError, ValueError):
            continue
        if isinstance(found, dict) and found.get("schema") == SCHEMA and found.get("digest") == cell.digest:
            return CellResult(found["result"], found["history"], path.parent / CHECKPOINT)
    return None


def keep_cell(cell: StudyCell, computed: CellResult, folder: Path) -> CellResult:
    """Write a cell and its result into a study's folder; returns the result as `find_cell` will find it.

    Its checkpoint and settings come first, and last, as the sign that all is there, its numbers.
    """
    assert isinstance(computed.checkpoint, bytes)
    place = folder / "cells" / cell.name
    content = {"schema": SCHEMA, "digest": cell.digest, "result": computed.scores, "history": computed.history}
    content = jsonable(content)
    write_whole(place / CHECKPOINT, computed.checkpoint)
    write_whole(place / CONFIG, yaml.safe_dump(dict(cell.keys), sort_keys=False, allow_unicode=True).encode())
    write_whole(place / CELL, (json.dumps(content, indent=1) + "\n").encode())
    return CellResult(content["result"], content["history"], place / CHECKPOINT)


def memory_sha256(dataset: Dataset) -> str:
    """SHA-256 of the object and of all that the tosses of a dataset in memory hold."""
    found = hashlib.sha256()
    _feed(found, (dataset.object, dataset.rate_hz, *dataset.tosses))
    return found.hexdigest()


def _feed(found: Any, value: Any) -> None:
    if isinstance(value, np.ndarray):
        found.update(f"{value.dtype} {value.shape} ".encode() + np.ascontiguousarray(value).tobytes())
    elif is_dataclass(value) and not isinstance(value, type):
        for each in fields(value):
            found.update(each.name.encode())
            _feed(found, getattr(value, each.name))
    elif isinstance(value, (tuple, list)):
        found.update(f"{len(value)} ".encode())
        for item in value:
            _feed(found, item)
    else:
        found.update(f"{value!r} ".encode())
