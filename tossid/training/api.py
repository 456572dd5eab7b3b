"""The verb `tossid.train`: from a dataset to a trained model."""

from __future__ import annotations

import copy
import hashlib
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
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
from tossid.training.report import convergence, geometry_report, seen_corners, size_contradiction
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


@contextmanager
def one_torch_thread() -> Iterator[None]:
    """Within it torch computes on one thread, and then on as many as before.

    Its tensors are small in training, and the numbers are then the same on every machine.
    """
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(before)


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


@one_torch_thread()
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
    sha256, versions = fingerprint(fit.train_tosses), computing_versions()
    parameters = learned_parameters(fit, history)
    return TrainedModel(fit.model, fit.settings, parameters, tuple(history), took, sha256=sha256, versions=versions)


def learned_parameters(fit: Fit, history: Sequence[EpochRecord]) -> dict[str, Any]:
    """What was learned, with intervals, and what is to be said of it, as `TrainedModel.parameters` has it.

    Args:
        fit: At its end.
        history: Its epochs.
    """
    parameters, unknown = fit.model.parameters_report(), fit.unknown
    intervals = parameter_intervals(fit)
    if intervals is not None:
        parameters["uncertainty"] = intervals
    if unknown is not None:
        parameters["from_nothing"] = unknown.as_json()
    if fit.model.mechanics() is not None:
        learned, scale = fit.model.learned_object(), fit.model.measurement.length_scale
        seen = seen_corners(learned, fit.true_tosses)
        if unknown is not None and learned.n_joints:
            # what another link keeps off the ground comes near it all the same
            seen &= np.concatenate([shape.frames > 0 for shape in unknown.shapes])
        parameters["geometry"] = geometry_report(learned, seen, length_scale=scale, history=fit.corner_history)
        parameters["convergence"] = convergence(learned, fit.evidence, history, fit.restarts, fit.settings)
    return {**parameters, **fit.remarks}


@one_torch_thread()
def prepare(dataset: Dataset, settings: TrainSettings) -> Fit:
    """The untrained fit of a model to a dataset's training tosses.

    Args:
        dataset: Tosses of one object, in the splits train and validation.
        settings: How to train.

    Raises:
        InputError: A split is empty, or has fewer tosses than asked for.
    """
    if settings.object is None and not dataset.object.is_stated:
        settings = replace(settings, object=UnknownObjectSettings(links=dataset.object.n_bodies))
    train, validation = training_tosses(dataset, settings)
    # no held-out toss takes part; where tosses are rationed, only those that are learned from do
    visible = (*train, *validation) if settings.tosses is None else train
    unknown = None if settings.object is None else unknown_object(visible, settings.object, tree=dataset.object)
    start, wanted = dataset.object if unknown is None else unknown.object, settings.model
    if unknown is not None:
        # a kind of model from outside may lack such settings
        known: dict[str, Any] = {name: value for name, value in unknown.kept().items() if hasattr(wanted, name)}
        settings = replace(settings, model=replace(wanted, **known))
    measured = estimate_measurement(train, start)
    measurement = measurement_of(settings.model, measured, stated=unknown is None)
    remarks: dict[str, Any] = {}
    if unknown is None and (size := size_contradiction(measured, measurement)) is not None:
        remarks["stated_size"] = size
    if (leak := leak_words(dataset.tosses)) is not None:
        remarks["copies"] = {"warning": leak}

    def fit_with(settings: TrainSettings, measurement: MeasurementModel, start: ObjectModel = start) -> Fit:
        model = build_model(settings.model, start, seed=settings.seed, measurement=measurement)
        return Fit(model, train, validation, settings, unknown=unknown, remarks=remarks)

    fit = fit_with(settings, measurement)
    shown = fit.contact_geometry
    if shown is not fit.model.object:
        # by corners that the tosses contradict, contact was taken for flight, or flight for contact
        lag = measurement_of(settings.model, estimate_measurement(train, shown), stated=unknown is None).velocity_lag
        if settings.model.learn_inertia and not settings.model.together:
            start = start.with_changes(inertia=shown.inertia)
        fit = fit_with(settings, replace(measurement, velocity_lag=lag), start)
    return fit


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
    return MeasurementModel(float(scale), found.measurement.velocity_lag if lag == "auto" else float(lag))


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
