"""The verb `tossid.train`: from a dataset to a trained model."""

from __future__ import annotations

import copy
import hashlib
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
import torch

from tossid.errors import InputError
from tossid.models import EpochRecord, ModelSettings, TrainedModel, build_model, variant
from tossid.motion import MeasurementEstimate, MeasurementModel, estimate_measurement
from tossid.motion.sessions.copies import leak_words
from tossid.objects import ObjectModel
from tossid.settings.changed import changed
from tossid.settings.objects import UnknownObjectSettings
from tossid.settings.training import TrainSettings
from tossid.store import Dataset
from tossid.training.fit import Fit
from tossid.training.restarts import convergence, geometry_report, seen_corners
from tossid.training.stated_size import size_contradiction
from tossid.training.uncertainty import parameter_intervals
from tossid.training.unknown import unknown_object
from tossid.types import Progress, Toss
from tossid.versions import computing_versions


@dataclass(frozen=True)
class Epoch:
    """An epoch that has just ended.

    Attributes:
        number: How many have ended, in all stages.
        record: Its losses.
        state: Gives the training's state now; `train(state=...)` goes on from it.
    """

    number: int
    record: EpochRecord
    state: Callable[[], dict[str, Any]]


def train(
    dataset: Dataset,
    *,
    model: str | ModelSettings | None = None,
    settings: TrainSettings = TrainSettings(),
    progress: Progress | None = None,
    each_epoch: Callable[[Epoch], None] | None = None,
    state: dict[str, Any] | None = None,
    **keys: Any,
) -> TrainedModel:
    """A model, fitted to the training tosses of a dataset and stopped by its validation tosses.

    One torch thread does it: the tensors are small, and the numbers are the same on every machine.

    Args:
        dataset: Tosses of one object, in the splits train and validation.
        model: A variant by name ("cn", "cnrp", "cnrpi", "diffsim", "e2e") or by its settings; None for that of
            `settings`, which is cnrpi by default.
        settings: How to train.
        progress: Called after every epoch with what is done and the share of the most epochs.
        each_epoch: Called after every epoch with its record.
        state: Of an interrupted training of the same settings and data, to go on from.
        **keys: Settings by name, such as `gravity=0.0`, `seed=1`, `epochs=50`.

    Returns:
        The trained model, with its parameters and their intervals.

    Raises:
        InputError: A split is empty, or has fewer tosses than asked for.
        ConfigError: A key is no setting, or the variant is unknown.
        DivergedError: The loss became NaN or infinite.
    """
    if model is not None:
        settings = replace(settings, model=variant(model) if isinstance(model, str) else model)
    settings = changed(settings, keys)
    return fit_model(prepare(dataset, settings), progress=progress, each_epoch=each_epoch, state=state)


def fit_model(
    fit: Fit,
    *,
    progress: Progress | None = None,
    each_epoch: Callable[[Epoch], None] | None = None,
    state: dict[str, Any] | None = None,
) -> TrainedModel:
    """Run a fit to its end; `train` is `prepare` and this.

    Args:
        fit: Of `prepare`.
        progress: As of `train`.
        each_epoch: As of `train`.
        state: As of `train`.

    Raises:
        DivergedError: The loss became NaN or infinite.
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
        if progress is not None:
            share = min(1.0, len(history) / fit.most_epochs)
            progress(f"{record.stage}: validation loss {record.validation_loss:.3g}", share)
        if each_epoch is not None:
            each_epoch(Epoch(len(history), record, state_now))
    took = seconds()
    parameters = fit.model.parameters_report()
    intervals = parameter_intervals(fit)
    if intervals is not None:
        parameters["uncertainty"] = intervals
    if fit.shown is not None:
        parameters["from_nothing"] = fit.shown.as_json()
    learned, true = fit.model.learned_object(), fit.true_tosses
    if fit.model.mechanics() is not None:
        seen = seen_corners(learned, true, fit.settings.restarts.evidence)
        if fit.shown is not None and learned.n_joints:
            # (what another link keeps off the ground comes near it all the same)
            seen &= np.concatenate([shape.frames > 0 for shape in fit.shown.shapes])
        scale = fit.model.measurement.length_scale
        parameters["geometry"] = geometry_report(learned, seen, length_scale=scale, way=fit.way)
        parameters["convergence"] = convergence(learned, fit.evidence, history, fit.restarts, fit.settings)
    if fit.size is not None:
        parameters["stated_size"] = fit.size
    if fit.leak is not None:
        parameters["copies"] = {"warning": fit.leak}
    sha256 = fingerprint(fit.train_tosses)
    return TrainedModel(
        fit.model, fit.settings, parameters, tuple(history), took, sha256=sha256, versions=computing_versions()
    )


def prepare(dataset: Dataset, settings: TrainSettings) -> Fit:
    """The untrained fit of a model to a dataset's training tosses.

    Args:
        dataset: Tosses of one object, in the splits train and validation.
        settings: How to train.

    Raises:
        InputError: A split is empty, or has fewer tosses than asked for.
    """
    torch.set_num_threads(1)
    if settings.object is None and not dataset.object.is_stated:
        settings = replace(settings, object=UnknownObjectSettings(links=dataset.object.n_bodies))
    train, validation = training_tosses(dataset, settings)
    # no held-out toss takes part; where tosses are rationed, only those that are learned from do
    looked_at = (*train, *validation) if settings.tosses is None else train
    shown = None if settings.object is None else unknown_object(looked_at, settings.object, tree=dataset.object)
    start, asked = dataset.object if shown is None else shown.object, settings.model
    if shown is not None and settings.object is not None:
        settings = replace(settings, model=keeping(settings.model, shown.kept(settings.object)))
    measured = estimate_measurement(train, start)
    measurement = measurement_of(settings.model, measured, stated=shown is None)
    size = size_contradiction(measured, measurement) if shown is None else None
    leak = leak_words(dataset.tosses)

    def fit_with(settings: TrainSettings, measurement: MeasurementModel, start: ObjectModel = start) -> Fit:
        model = build_model(settings.model, start, seed=settings.seed, measurement=measurement)
        return Fit(model, train, validation, settings, shown=shown, size=size, leak=leak)

    fit = fit_with(settings, measurement)
    if fit.near is not fit.model.object:
        # by corners that the tosses contradict, contact was taken for flight, or flight for contact
        found = estimate_measurement(train, fit.near)
        lag = measurement_of(settings.model, found, stated=shown is None).velocity_lag
        if settings.model.learn_inertia and not settings.model.together:
            start = start.with_changes(inertia=fit.near.inertia)
        fit = fit_with(settings, replace(measurement, velocity_lag=lag), start)
    kept, is_kept = settings.model, asked.learn_friction and not settings.model.learn_friction
    if not is_kept or not kept.horizons or not fit.friction_contradicted(kept.horizons[-1]):
        return fit
    # friction in impacts is not that of sliding
    return fit_with(replace(settings, model=replace(kept, learn_friction=True)), fit.model.measurement)


def keeping(model: ModelSettings, kept: Mapping[str, Any]) -> ModelSettings:
    """The settings of a model that keeps what is known, as far as it has such settings.

    Args:
        model: Of any kind.
        kept: Of `UnknownObject.kept`.
    """
    known: dict[str, Any] = {name: value for name, value in kept.items() if hasattr(model, name)}
    return replace(model, **known)


def measurement_of(settings: ModelSettings, found: MeasurementEstimate, *, stated: bool = True) -> MeasurementModel:
    """How recorded motion relates to true motion: as stated, or, where that is "auto", as the tosses show it.

    Args:
        settings: What is stated.
        found: What the training tosses show.
        stated: Whether the object's size is stated; a size that the tosses themselves have shown tells no scale.
    """
    scale, lag = settings.length_scale, settings.velocity_lag
    if scale == "auto":
        scale = found.measurement.length_scale if stated else 1.0
    return MeasurementModel(
        float(scale),
        found.measurement.velocity_lag if lag == "auto" else float(lag),
    )


def training_tosses(dataset: Dataset, settings: TrainSettings) -> tuple[tuple[Toss, ...], tuple[Toss, ...]]:
    """The tosses to learn from, and those that end the training.

    Args:
        dataset: With the splits train and validation.
        settings: `tosses` of them are drawn by `seed`.

    Raises:
        InputError: A split is empty, or has fewer tosses than asked for.
    """
    train, validation = tuple(dataset.of_split("train")), tuple(dataset.of_split("validation"))
    for split, found in (("train", train), ("validation", validation)):
        if not found:
            raise InputError(f"no tosses in split '{split}'; training needs at least three tosses")
    count = settings.tosses
    if count is None:
        return train, validation
    if count > len(train):
        raise InputError(f"tosses={count}: the dataset has {len(train)} training tosses")
    rng = np.random.default_rng(settings.seed)
    first, other = rng.permutation(len(train)), rng.permutation(len(validation))
    return tuple(train[i] for i in first[:count]), tuple(validation[i] for i in other[:count])


def fingerprint(tosses: Sequence[Toss]) -> str:
    """A SHA-256 of tosses' times, configurations and velocities, by which data in memory are known again.

    Args:
        tosses: In their order.
    """
    found = hashlib.sha256()
    for toss in tosses:
        found.update(toss.name.encode())
        for values in (toss.t, toss.q, toss.v):
            found.update(np.ascontiguousarray(values).tobytes())
    return found.hexdigest()
