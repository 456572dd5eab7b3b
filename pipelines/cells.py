"""Cells of a study: which there are, how they are told apart, and how they are computed, several at a time."""

from __future__ import annotations

import io
import os
import re
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from functools import lru_cache, partial
from pathlib import Path
from typing import Any

from pipelines.calling import digest_of
from pipelines.config import as_plain, load
from pipelines.keys import convert
from pipelines.schemas import Launcher, ProcessesLauncher, SweepConfig, TrainConfig
from pipelines.version import code_digest
from pipelines.workers import as_done, open_workers
from tossid.errors import ConfigError, FileError, TossidError
from tossid.store import file_sha256, read_dataset
from tossid.types import Dataset

SCHEMA = "tossid.cell/1"
_OWN = ("data", "restart", "model", "seed")
"""Keys of train that a study sets itself."""


@dataclass(frozen=True)
class Cell:
    """One training and its evaluation.

    model: as the study names it: one of conf/model, and further keys of its own behind it ("cn optimizer=adam").
    digest: of all that its numbers depend on (keys of train, data, code), so that it is known again.
    """

    model: str
    seed: int
    value: float
    config: TrainConfig
    digest: str

    @property
    def name(self) -> str:
        model = re.sub(r"[^\w.=-]+", "-", self.model)
        return f"{model}-{self.value:g}-s{self.seed}-{self.digest[:12]}"


@dataclass(frozen=True)
class Computed:
    """What a cell gave: plain values, and the model's state as `torch.save` writes it."""

    result: dict[str, Any]
    history: list[dict[str, Any]]
    state: bytes


def study_cells(sweep: SweepConfig, data: Path, sha256: str) -> tuple[Cell, ...]:
    """The cells of a study, in the order models, values, seeds.

    Raises:
        ConfigError: nothing is swept, or `tossid train` would refuse a key.
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
    from pipelines.learning import learning_keys

    parts = [SCHEMA, learning_keys(config), sha256, code_digest()]
    return digest_of(parts)


# ---------------------------------------------------------------- computing


def compute(dataset: Dataset, config: TrainConfig) -> Computed:
    """Train on the dataset's training tosses, judge on its test tosses."""
    import torch

    from pipelines.learning import evaluate_model, prepare, train_model

    trained = train_model(prepare(dataset, config))
    tosses = dataset.of_split("test")
    judged = evaluate_model(trained.model, dataset.object, tosses)
    state = io.BytesIO()
    torch.save(trained.model.state_dict(), state)
    result = {
        **judged.metrics,
        "n_tosses": len(tosses),
        "parameters": trained.model.parameters_report(),
        "epochs": len(trained.history),
        "seconds": trained.seconds,
    }
    return Computed(result, [asdict(record) for record in trained.history], state.getvalue())


def compute_all(
    cells: Sequence[Cell], *, sha256: str, workers: int | None, launcher: Launcher
) -> Iterator[tuple[Cell, Computed | TossidError]]:
    """Each cell with what it gave (or the error that it ended in), as they are done.

    Args:
        sha256: of the cells' dataset, which workers read for themselves.
        workers: processes, each with one thread; None for one a core. With one, no process is started.
        launcher: who computes.

    Raises:
        SolverError: a worker died.
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
    return compute(_read(Path(folder) / cell.config.data, sha256), cell.config)


@lru_cache(maxsize=1)
def _read(data: Path, sha256: str) -> Dataset:
    """A worker's dataset."""
    if file_sha256(data) != sha256:
        raise FileError(data, "is not the file that the command reads; its workers must see the same one there")
    return read_dataset(data)
