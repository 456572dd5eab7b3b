"""Cells of a study: which there are, how they are identified, and how they are computed, several at a time."""

from __future__ import annotations

import os
import re
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from functools import lru_cache, partial
from pathlib import Path
from typing import Any

from pipelines.cli.call import digest_of
from pipelines.commands.train import learning_keys
from pipelines.config.compose import as_plain, load
from pipelines.config.keys import convert
from pipelines.config.schemas import Launcher, ProcessesLauncher, SweepConfig, TrainConfig
from pipelines.execution.workers import as_done, open_workers
from tossid.code_digest import code_digest
from tossid.errors import ConfigError, FileError, TossidError
from tossid.store import Dataset, file_sha256, read_dataset

SCHEMA = "tossid.cell/1"
_COMPUTES = ("tossid.training.api", "tossid.evaluation.evaluate")
"""The modules of the two calls of `compute`: a cell is kept under the digest of their code."""
_OWN = ("data", "restart", "model", "seed")
"""Keys of train that a study sets itself."""


@dataclass(frozen=True)
class Cell:
    """One training and its evaluation.

    Attributes:
        model: As the study names it: one of conf/model, and further keys of its own behind it ("cn optimizer=adam").
        seed: Of the training.
        value: Of the swept key.
        config: Of the training.
        digest: Of all that its numbers depend on (keys of train, data, code).
    """

    model: str
    seed: int
    value: float
    config: TrainConfig
    digest: str

    @property
    def name(self) -> str:
        """Its folder's name."""
        model = re.sub(r"[^\w.=-]+", "-", self.model)
        return f"{model}-{self.value:g}-s{self.seed}-{self.digest[:12]}"


@dataclass(frozen=True)
class Computed:
    """What a cell gave.

    Attributes:
        result: Metrics and parameters, as plain values.
        history: Epoch records.
        checkpoint: The model's file.
    """

    result: dict[str, Any]
    history: list[dict[str, Any]]
    checkpoint: bytes


def study_cells(sweep: SweepConfig, data: Path, sha256: str) -> tuple[Cell, ...]:
    """The cells of a study, in the order models, values, seeds.

    Args:
        sweep: The study's keys.
        data: The dataset.
        sha256: Of the dataset.

    Raises:
        ConfigError: Nothing is swept, or `tossid train` would refuse a key.
    """
    for name in ("values", "models", "seeds"):
        if not getattr(sweep, name):
            raise ConfigError(f"sweep.{name}", "is empty; a study needs at least one.")
        if len(set(getattr(sweep, name))) < len(getattr(sweep, name)):
            raise ConfigError(f"sweep.{name}", "names one twice.")
    own = [text for model in sweep.models for text in model.split()[1:]]
    for where, texts in (("sweep.train", sweep.train), ("sweep.key", [f"{sweep.key}="]), ("sweep.models", own)):
        for text in texts:
            if text.partition("=")[0] in _OWN:
                raise ConfigError(where, f"{text.partition('=')[0]} is set by the study itself.")
    cells = []
    for model in sweep.models:
        first = f"{sweep.key}={_number(sweep.values[0])}"
        name, *keys = model.split()
        base = replace(load("train", TrainConfig, [f"model={name}", first, *sweep.train, *keys]), data=data)
        for value in sweep.values:
            for seed in sweep.seeds:
                config = _with(_with(base, sweep.key, _number(value)), "seed", seed)
                cells.append(Cell(model, seed, value, config, _digest(config, sha256)))
    return tuple(cells)


def _number(value: float) -> int | float:
    return int(value) if value.is_integer() else value


def _with(config: TrainConfig, key: str, value: int | float) -> TrainConfig:
    values = as_plain(config)
    *path, last = key.split(".")
    part = values
    for name in path:
        part = part[name]
    part[last] = value
    changed = convert(TrainConfig, values, key="")
    assert isinstance(changed, TrainConfig)
    return changed


def _digest(config: TrainConfig, sha256: str) -> str:
    return digest_of([SCHEMA, learning_keys(config), sha256, code_digest(*_COMPUTES)])


# ---------------------------------------------------------------- computing


def compute(dataset: Dataset, config: TrainConfig, sha256: str = "") -> Computed:
    """Train on the dataset's training tosses, evaluate on its test tosses.

    Args:
        dataset: With all splits.
        config: Of the training.
        sha256: Of the dataset's file.
    """
    from tossid import evaluate, train
    from tossid.models.checkpoints import checkpoint_bytes

    trained = train(dataset, settings=config.settings(), threads=1)
    scores = evaluate(trained, dataset.split("test"))
    result = {**scores.as_json(), "epochs": len(trained.history), "seconds": trained.seconds}
    del result["model"]  # a cell has a longer name
    kept = replace(trained, data=config.data, sha256=sha256)
    return Computed(result, [asdict(record) for record in trained.history], checkpoint_bytes(kept))


def compute_all(
    cells: Sequence[Cell], *, sha256: str, workers: int | None, launcher: Launcher
) -> Iterator[tuple[Cell, Computed | TossidError]]:
    """Each cell with what it gave (or the error that it ended in), as they are done.

    Args:
        cells: To compute.
        sha256: Of the cells' dataset, which workers read for themselves.
        workers: Processes, each with one thread; None for one a core. With one, no process is started.
        launcher: Who computes.

    Yields:
        A cell, and what it gave.

    Raises:
        SolverError: A worker died.
    """
    if not cells:
        return
    work = partial(_compute, sha256=sha256, folder=os.getcwd())
    if isinstance(launcher, ProcessesLauncher):
        workers = min(workers or os.cpu_count() or 1, len(cells))
        if workers <= 1:
            yield from as_done(work, cells, None)
            return
    with open_workers(launcher, workers) as there:
        yield from as_done(work, cells, there.submit)


def _compute(cell: Cell, *, sha256: str, folder: str) -> Computed:
    assert cell.config.data is not None
    data = Path(folder) / cell.config.data
    return compute(_read(data, sha256), replace(cell.config, data=data), sha256)


@lru_cache(maxsize=1)
def _read(data: Path, sha256: str) -> Dataset:
    """A worker's dataset."""
    if file_sha256(data) != sha256:
        raise FileError(data, "is not the file that the command reads; its workers must see the same one there")
    return read_dataset(data)
