"""Cells of a study: which there are, how they are told apart, and how they are computed, several at a time."""

from __future__ import annotations

import hashlib
import io
import json
import multiprocessing
import os
import re
import signal
import threading
from collections.abc import Iterator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from dataclasses import asdict, dataclass, replace
from multiprocessing import connection
from pathlib import Path
from typing import Any

from pipelines.config import as_plain, load
from pipelines.keys import convert
from pipelines.schemas import SweepConfig, TrainConfig
from pipelines.version import code_digest
from tossid.errors import ConfigError, SolverError, TossidError
from tossid.types import Dataset

SCHEMA = "tossid.cell/1"
_ONE_THREAD = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")
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
    return hashlib.sha256(json.dumps(parts, sort_keys=True).encode()).hexdigest()


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
    dataset: Dataset, cells: Sequence[Cell], *, workers: int | None
) -> Iterator[tuple[Cell, Computed | TossidError]]:
    """Each cell with what it gave (or the error that it ended in), as they are done.

    Args:
        workers: processes, each with one thread; None for one a core. With one, no process is started.

    Raises:
        SolverError: a process died.
    """
    count = min(workers or os.cpu_count() or 1, len(cells))
    if count <= 1:
        for cell in cells:
            try:
                yield cell, compute(dataset, cell.config)
            except TossidError as error:
                yield cell, error
        return
    with worker_processes(dataset, count) as pool:
        waiting: dict[Future[Computed], Cell] = {pool.submit(_compute, cell.config): cell for cell in cells}
        for done in as_completed(waiting):
            try:
                yield waiting[done], done.result()
            except BrokenProcessPool as error:
                problem = "a process died (of lack of memory?); give the same command again, with sweep.workers=1"
                raise SolverError(problem, total=count) from error
            except TossidError as error:
                yield waiting[done], error


@contextmanager
def worker_processes(dataset: Dataset | None, count: int) -> Iterator[ProcessPoolExecutor]:
    """Worker processes, which hold the dataset if there is one; whatever ends the study ends them at once."""
    before = {name: os.environ.get(name) for name in _ONE_THREAD}
    os.environ.update(dict.fromkeys(_ONE_THREAD, "1"))  # libraries read it when a worker imports them
    context = multiprocessing.get_context("spawn")
    pool = ProcessPoolExecutor(count, mp_context=context, initializer=_begin, initargs=(dataset,))
    try:
        yield pool
    except BaseException:
        for child in multiprocessing.active_children():
            child.terminate()
        raise
    finally:
        pool.shutdown(cancel_futures=True)
        for name, value in before.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value


_dataset: Dataset | None = None
"""A worker's dataset."""


def _begin(dataset: Dataset | None) -> None:
    """Begin a worker: Ctrl-C is its parent's business, and it does not outlive its parent."""
    global _dataset
    _dataset = dataset
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    parent = multiprocessing.parent_process()
    if parent is not None:
        threading.Thread(target=_end_with, args=(parent.sentinel,), daemon=True).start()


def _end_with(sentinel: int) -> None:
    connection.wait([sentinel])
    os._exit(1)


def _compute(config: TrainConfig) -> Computed:
    assert _dataset is not None
    return compute(_dataset, config)
