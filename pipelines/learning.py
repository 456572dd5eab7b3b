"""Training and judging a model, without files and tracker: what `train`, `evaluate` and the cells of a sweep share."""

from __future__ import annotations

import copy
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from typing import Any

import numpy as np
import torch

from pipelines.checkpoints import build_model
from pipelines.config import as_plain
from pipelines.schemas import ModelConfig, TrainConfig
from tossid.errors import InputError
from tossid.evaluation.metrics import (
    TossScores,
    frame_time,
    joined,
    roll_out,
    score_tosses,
    score_windows,
    summarize_scores,
)
from tossid.models.protocol import DynamicsModel
from tossid.motion import Calibration, Measurement, calibrate
from tossid.objects import ObjectModel
from tossid.training.fit import EpochRecord, Fit, FitSettings
from tossid.types import Dataset, OnDemand, Rollout, Toss

BATCH = 256
"""Tosses that are rolled out together."""
NOT_LEARNING = ("data", "restart")
"""Keys of train that leave a training of given data as it is."""


@dataclass(frozen=True)
class Trained:
    """A trained model, its epochs, and the time that they took [s] (interrupted ones included)."""

    model: DynamicsModel
    history: tuple[EpochRecord, ...]
    seconds: float


@dataclass(frozen=True)
class Judged:
    """What rollouts of held-out tosses show.

    Attributes:
        metrics: CONTRACT.md's, with `from_flight` for an object without joints, `sixteen_steps`, and the counts
            `unsolved` and `diverged`.
        scores: of each toss, from its first state.
        names: of the tosses.
        dt: between frames [s], as they were rolled out.
    """

    metrics: dict[str, Any]
    scores: TossScores
    names: tuple[str, ...]
    dt: float


def learning_keys(config: TrainConfig) -> dict[str, Any]:
    """The keys that decide, with the data, what is learned."""
    return {name: value for name, value in as_plain(config).items() if name not in NOT_LEARNING}


def prepare(dataset: Dataset, config: TrainConfig, *, n_threads: int = 1) -> Fit:
    """The untrained fit of the model that the keys name to the dataset's training tosses.

    One torch thread does it: the tensors are small, and the numbers are the same on every machine.

    Args:
        n_threads: for rollouts, which part tosses among them; the numbers do not depend on it.

    Raises:
        InputError: a split is empty, or has fewer tosses than asked for.
    """
    torch.set_num_threads(1)
    train, validation = training_tosses(dataset, config)
    measurement = measured(config.model, calibrate(train, dataset.object))
    return Fit(
        build_model(config.model, dataset.object, seed=config.seed, measurement=measurement),
        train,
        validation,
        FitSettings(
            epochs=config.epochs,
            patience=config.patience,
            optimizer=config.optimizer,
            learning_rate=config.learning_rate,
            horizons=config.model.horizons,
            n_threads=n_threads,
        ),
    )


def measured(config: ModelConfig, shown: Calibration) -> Measurement:
    """The measurement that the keys state, or, where they say auto, that the training tosses show."""
    return Measurement(
        shown.measurement.length_scale if config.length_scale == "auto" else float(config.length_scale),
        shown.measurement.velocity_lag if config.velocity_lag == "auto" else float(config.velocity_lag),
    )


def train_model(
    fit: Fit,
    *,
    state: dict[str, Any] | None = None,
    watch: Callable[[int, EpochRecord, Callable[[], dict[str, Any]]], None] | None = None,
) -> Trained:
    """Run a fit to its end.

    Args:
        fit: of `prepare`.
        state: of an interrupted training of the same keys and data, to go on from.
        watch: called after every epoch with the number of epochs so far, the epoch's record,
            and a function that returns the state now.

    Raises:
        DivergedError: the loss became NaN or infinite.
    """
    history: list[EpochRecord] = []
    before, started = 0.0, time.perf_counter()
    if state is not None:
        fit.load_state_dict(copy.deepcopy(state["fit"]))
        history = [EpochRecord(**row) for row in state["history"]]
        before = float(state["seconds"])

    def seconds() -> float:
        return before + time.perf_counter() - started

    def state_now() -> dict[str, Any]:
        rows = [asdict(record) for record in history]
        return {"fit": copy.deepcopy(fit.state_dict()), "history": rows, "seconds": seconds()}

    for record in fit.epochs():
        history.append(record)
        if watch is not None:
            watch(len(history), record, state_now)
    return Trained(fit.model, tuple(history), seconds())


def training_tosses(dataset: Dataset, config: TrainConfig) -> tuple[tuple[Toss, ...], tuple[Toss, ...]]:
    """The tosses to learn from and those that end the training; `config.tosses` are drawn by the seed."""
    train, validation = tuple(dataset.of_split("train")), tuple(dataset.of_split("validation"))
    for split, found in (("train", train), ("validation", validation)):
        if not found:
            raise InputError(f"no tosses in split '{split}'; training needs at least three tosses")
    if config.tosses is None:
        return train, validation
    if config.tosses > len(train):
        raise InputError(f"tosses={config.tosses}: the dataset has {len(train)} training tosses")
    rng = np.random.default_rng(config.seed)
    first, other = rng.permutation(len(train)), rng.permutation(len(validation))
    return tuple(train[i] for i in first[: config.tosses]), tuple(validation[i] for i in other[: config.tosses])


def numbers_of(record: EpochRecord) -> dict[str, float]:
    """An epoch's losses, as they are tracked."""
    losses = {"train": record.train_loss, "validation": record.validation_loss, **record.parts}
    return {f"{record.stage}/{name}": value for name, value in losses.items()}


def evaluate_model(model: DynamicsModel, nominal: ObjectModel, tosses: Sequence[Toss]) -> Judged:
    """Roll the tosses out open loop and measure.

    Args:
        nominal: the object whose centre, width and corners are compared.
        tosses: `BATCH` of them are in memory at a time.
    """
    predictor, measurement, dt = model.simulator(), model.measurement, frame_time(tosses)
    starts, flights, windows, names = [], [], [], []
    for first in range(0, len(tosses), BATCH):
        batch = tosses[first : first + BATCH]
        score = partial(score_tosses, predictor, nominal, batch, measurement=measurement, dt=dt)
        starts.append(score())
        if nominal.n_joints == 0:
            flights.append(score(from_flight=True))
        windows.append(score_windows(predictor, nominal, batch, measurement=measurement, dt=dt))
        names += [toss.name for toss in batch]
    scores = joined(starts)
    metrics: dict[str, Any] = summarize_scores(scores, nominal)
    if flights:
        metrics["from_flight"] = summarize_scores(joined(flights), nominal)
    metrics["sixteen_steps"] = summarize_scores(joined(windows), nominal)
    metrics |= {"unsolved": scores.unsolved, "diverged": scores.diverged}
    return Judged(metrics, scores, tuple(names), dt)


def predicted_motions(
    model: DynamicsModel, nominal: ObjectModel, tosses: Sequence[Toss], *, dt: float | None = None
) -> OnDemand[Rollout]:
    """The motions that `evaluate_model` scores: those next to the one asked for are rolled out with it, and kept."""
    predictor, measurement, dt = model.simulator(), model.measurement, dt or frame_time(tosses)

    def batch(k: int) -> tuple[Rollout, ...]:
        some = tosses[k * BATCH : (k + 1) * BATCH]
        return roll_out(predictor, nominal, some, measurement=measurement, dt=dt)

    batches = OnDemand(batch, -(-len(tosses) // BATCH), kept=1)
    return OnDemand(lambda i: batches[i // BATCH][i % BATCH], len(tosses), kept=0)
