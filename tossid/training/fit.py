"""The fit loop: stage by stage, each stopped early on validation tosses.

1. "continuous": the residual acceleration, by the implicit loss on transitions that surely involve no contact.
   Learned together with contact, impulses at rest would stand in for missing gravity.
2. "contact": geometry, friction (and inertia), by the implicit loss on all transitions.
   (The unstructured `e2e` has one stage instead, "one-step".)
3. "rollout-N": friction (and contact law and inertia), by open-loop prediction until N frames after first contact,
   N growing: short predictions are smooth in the parameters from far away, long ones decide the last digits.
   Of objects with joints, over stretches of N frames from everywhere in a toss.

The loop yields records and knows no tracker. Its state is plain tensors and
numbers, so that an interrupted fit goes on exactly where it was.
"""

from __future__ import annotations

import copy
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from tossid.errors import DivergedError
from tossid.models.protocol import DynamicsModel
from tossid.models.shots import Shots, first_states, flight_starts, make_shots, make_stretches
from tossid.models.transitions import make_transitions
from tossid.motion import FlightState
from tossid.objects import ObjectModel
from tossid.training.stages import LossStage, RolloutStage, Stage
from tossid.types import Toss

ROLLOUT_EPOCHS = 15
"""At most this many Gauss-Newton steps a rollout stage."""


@dataclass(frozen=True)
class FitSettings:
    """How long and how carefully to fit.

    Attributes:
        epochs: at most this many epochs a stage of the implicit loss.
        patience: stop a stage after this many epochs without a better validation loss.
        min_improvement: relative improvement that counts as better.
        optimizer: of the implicit loss: "lbfgs" or "adam". learning_rate: Adam's.
        horizons: frames after first contact of the rollout stages, one after another; none for the implicit loss alone.
            Objects with joints: stretches (`shots.make_stretches`) of half the first, and then of the first.
        n_threads: for rollouts.
    """

    epochs: int = 60
    patience: int = 8
    min_improvement: float = 1e-4
    optimizer: str = "lbfgs"
    learning_rate: float = 1e-3
    horizons: tuple[int, ...] = (20, 90)
    n_threads: int = 1


@dataclass(frozen=True)
class EpochRecord:
    """One epoch: losses (implicit [m²/s²], rollout [half widths², rad²]) and the loss's parts on training data.

    passes: how often the data were gone through. best: the validation loss was the stage's best so far.
    """

    stage: str
    epoch: int
    train_loss: float
    validation_loss: float
    parts: dict[str, float]
    passes: int
    seconds: float
    best: bool


@dataclass(frozen=True)
class _Flights:
    """What the flights said of the first states, for a model as it was."""

    model: ObjectModel
    gravity: float
    fitted: tuple[list[FlightState | None], ...]

    COM_REL, INERTIA_REL, GRAVITY_REL = 1e-3, 0.01, 1e-3
    """Changes (in widths, and relative) that first states do not feel."""

    def outdated(self, model: ObjectModel, gravity: float) -> bool:
        return bool(
            np.abs(model.com - self.model.com).max() > self.COM_REL * model.width
            or np.abs(model.inertia - self.model.inertia).max() > self.INERTIA_REL * np.abs(self.model.inertia).max()
            or abs(gravity - self.gravity) > self.GRAVITY_REL * max(abs(gravity), 1.0)
        )


class Fit:
    """A fit under way.

    Args:
        model: fitted in place; holds the best parameters when `epochs` is exhausted.
        train, validation: different tosses of the model's object, as recorded.
    """

    def __init__(
        self,
        model: DynamicsModel,
        train: Sequence[Toss],
        validation: Sequence[Toss],
        settings: FitSettings | None = None,
    ) -> None:
        self.model = model
        self.settings = settings or FitSettings()
        true = model.measurement.true_toss
        self._tosses = (tuple(true(toss) for toss in train), tuple(true(toss) for toss in validation))
        self._transitions = tuple(make_transitions(model.object, tosses) for tosses in self._tosses)
        horizons = self.settings.horizons
        if model.object.n_joints and horizons:  # a few impacts on, links are anywhere
            horizons = (max(1, horizons[0] // 2), horizons[0])
        self.stages = model.stages(horizons)
        self.stage = 0
        self.epoch = 0
        self.stale = 0
        self.best_loss = float("inf")
        self.best = copy.deepcopy(model.state_dict())
        self._current: Stage | None = None
        self._flights: _Flights | None = None

    def _make(self, stage: str) -> Stage:
        """A stage, when its turn comes: what it starts from is the model as it is then."""
        settings, parameters = self.settings, self.model.stage_parameters(stage)
        if stage.startswith("rollout-"):
            make = partial(self._shots, int(stage.removeprefix("rollout-")))
            return RolloutStage(
                stage, self.model, parameters, make, epochs=ROLLOUT_EPOCHS, n_threads=settings.n_threads
            )
        train, validation = self._transitions
        if stage == "continuous":
            train, validation = train.in_flight(), validation.in_flight()
        return LossStage(
            stage,
            self.model,
            parameters,
            train,
            validation,
            epochs=settings.epochs,
            optimizer="adam" if stage == "one-step" else settings.optimizer,
            learning_rate=settings.learning_rate,
        )

    def longest_rollout(self) -> RolloutStage | None:
        """The last rollout stage, at the model's present parameters; None for a model that has none."""
        stage = self._make(self.stages[-1])
        return stage if isinstance(stage, RolloutStage) else None

    def _shots(self, horizon: int) -> tuple[Shots, Shots]:
        learned, gravity = self.model.learned_object(), self.model.flight_gravity(self._transitions[0])
        predictor, lag = self.model.simulator(), self.model.measurement.velocity_lag
        if learned.n_joints:
            train, validation = (
                make_stretches(learned, tosses, predictor, steps=horizon, velocity_lag=lag) for tosses in self._tosses
            )
            return train, validation
        if self._flights is None or self._flights.outdated(learned, gravity):
            fitted = tuple(flight_starts(learned, tosses, gravity=gravity) for tosses in self._tosses)
            self._flights = _Flights(learned, gravity, fitted)
        train, validation = (
            make_shots(
                learned,
                tosses,
                horizon=horizon,
                first=first_states(tosses, learned, predictor, velocity_lag=lag),
                flight=flight,
            )
            for tosses, flight in zip(self._tosses, self._flights.fitted, strict=True)
        )
        return train, validation

    def state_dict(self) -> dict[str, Any]:
        """Everything needed to go on: tensors, numbers and strings only."""
        return {
            "stage": self.stage,
            "epoch": self.epoch,
            "stale": self.stale,
            "best_loss": self.best_loss,
            "best": self.best,
            "model": copy.deepcopy(self.model.state_dict()),
            "current": None if self._current is None else self._current.state_dict(),
        }

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Go on from `state_dict()` of an equal fit."""
        self.stage, self.epoch, self.stale = state["stage"], state["epoch"], state["stale"]
        self.best_loss, self.best = state["best_loss"], state["best"]
        self.model.load_state_dict(state["model"])
        self._current = None
        if state["current"] is not None and self.stage < len(self.stages):
            self._current = self._make(self.stages[self.stage])
            self._current.load_state_dict(state["current"])

    def epochs(self) -> Iterator[EpochRecord]:
        """Fit, one record an epoch.

        Raises:
            DivergedError: the loss became NaN or infinite; the state before it is attached.
        """
        while self.stage < len(self.stages):
            if self._current is None:
                self._current = self._make(self.stages[self.stage])
                self._current.begin()
            done = False
            while not done and self.epoch < self._current.epochs and self.stale < self.settings.patience:
                record, done = self._step(self._current)
                if done:
                    self.epoch = self._current.epochs
                yield record
            self.model.load_state_dict(self.best)
            self.stage, self.epoch, self.stale = self.stage + 1, 0, 0
            self.best_loss, self._current = float("inf"), None

    def _step(self, stage: Stage) -> tuple[EpochRecord, bool]:
        before = copy.deepcopy(self.model.state_dict())
        started = time.perf_counter()
        now = stage.step()
        seconds = time.perf_counter() - started
        if now.train_loss - now.train_loss != 0.0 or now.validation_loss != now.validation_loss:
            raise DivergedError(
                f"the loss became {now.train_loss} in stage '{stage.name}', epoch {self.epoch}", state=before
            )
        better = now.validation_loss < self.best_loss * (1 - self.settings.min_improvement)
        if better:
            self.best_loss, self.best, self.stale = now.validation_loss, copy.deepcopy(self.model.state_dict()), 0
        else:
            self.stale += 1
        self.epoch += 1
        record = EpochRecord(
            stage.name, self.epoch, now.train_loss, now.validation_loss, now.parts, now.passes, seconds, better
        )
        return record, now.done
