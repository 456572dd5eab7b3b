"""The fit loop: stage by stage, each stopped early on validation tosses.

The model names its stages (`models.protocol.StagePlan`); for ContactNets these are

1. "continuous": the learned acceleration, by the implicit loss on transitions that surely involve no contact. Learned
   together with contact, impulses at rest would stand in for missing gravity.
2. "contact": geometry, friction (and inertia), by the implicit loss on all transitions.
3. "rollout-N": friction (and contact law and inertia), by open-loop prediction until N frames after first contact,
   N growing: short predictions are smooth in the parameters from far away, long ones decide the last digits. Of objects
   with joints, over stretches of N frames from everywhere in a toss.

The loop yields records and knows no tracker. Its state is plain tensors and numbers, so that an interrupted fit goes on
exactly where it was.
"""

from __future__ import annotations

import copy
import os
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from tossid.errors import DivergedError
from tossid.models.protocol import DynamicsModel, Objective, StagePlan
from tossid.models.shots import Shots, first_states, flight_starts, make_shots, make_stretches
from tossid.models.trained import EpochRecord
from tossid.models.transitions import Transitions, make_transitions
from tossid.motion import FlightState
from tossid.objects import ObjectModel
from tossid.settings.training import TrainSettings
from tossid.training.losses import LossStage, Stage
from tossid.training.rollouts import RolloutStage
from tossid.training.unknown import UnknownObject
from tossid.types import Toss


@dataclass(frozen=True)
class _Flights:
    """First states that flights gave, for a model as it was."""

    model: ObjectModel
    gravity: float
    fitted: tuple[list[FlightState | None], ...]

    COM_REL, INERTIA_REL, GRAVITY_REL = 1e-3, 0.01, 1e-3
    """Changes (in widths, and relative) on which first states do not depend."""

    def outdated(self, model: ObjectModel, gravity: float) -> bool:
        return bool(
            np.abs(model.com - self.model.com).max() > self.COM_REL * model.width
            or np.abs(model.inertia - self.model.inertia).max() > self.INERTIA_REL * np.abs(self.model.inertia).max()
            or abs(gravity - self.gravity) > self.GRAVITY_REL * max(abs(gravity), 1.0)
        )


class Fit:
    """A fit in progress.

    Args:
        model: Fitted in place; holds the best parameters when `epochs` is exhausted.
        train: Tosses to learn from, as recorded.
        validation: Other tosses, which end the stages.
        settings: How long and how carefully.
        shown: What the tosses showed of an unknown object, from which the model starts.
    """

    def __init__(
        self,
        model: DynamicsModel,
        train: Sequence[Toss],
        validation: Sequence[Toss],
        settings: TrainSettings | None = None,
        *,
        shown: UnknownObject | None = None,
    ) -> None:
        self.model = model
        self.shown = shown
        self.settings = settings or TrainSettings()
        self.train_tosses = tuple(train)
        true = model.measurement.true_toss
        self._tosses = (tuple(true(toss) for toss in train), tuple(true(toss) for toss in validation))
        self._transitions = tuple(
            make_transitions(model.object, tosses, self.settings.transitions) for tosses in self._tosses
        )
        self._n_threads = self.settings.threads or os.cpu_count() or 1
        self.stages = model.stages()
        self.stage = 0
        self.epoch = 0
        self.stale = 0
        self.best_loss = float("inf")
        self.best = copy.deepcopy(model.state_dict())
        self._current: Stage | None = None
        self._flights: _Flights | None = None

    @property
    def most_epochs(self) -> int:
        """How many epochs there can be."""
        most = {Objective.ROLLOUT: self.settings.rollouts.epochs}
        return sum(most.get(plan.objective, self.settings.epochs) for plan in self.stages)

    def _make(self, plan: StagePlan) -> Stage:
        """A stage, when its turn comes: it starts from the model as it is then."""
        make: dict[Objective, Callable[[StagePlan], Stage]] = {
            Objective.FLIGHT_LOSS: partial(self._loss_stage, choose=Transitions.in_flight),
            Objective.LOSS: self._loss_stage,
            Objective.ROLLOUT: self._rollout_stage,
        }
        return make[plan.objective](plan)

    def _loss_stage(self, plan: StagePlan, choose: Callable[[Transitions], Transitions] = lambda t: t) -> LossStage:
        train, validation = (choose(transitions) for transitions in self._transitions)
        return LossStage(plan, self.model, train, validation, self.settings)

    def _rollout_stage(self, plan: StagePlan) -> RolloutStage:
        make = partial(self._shots, plan.horizon)
        return RolloutStage(plan, self.model, make, self.settings.rollouts, n_threads=self._n_threads)

    def longest_rollout(self) -> RolloutStage | None:
        """The last stage at the model's present parameters, if it is one of rollouts; None otherwise."""
        last = self.stages[-1]
        return self._rollout_stage(last) if last.objective is Objective.ROLLOUT else None

    def _shots(self, horizon: int) -> tuple[Shots, Shots]:
        learned, gravity = self.model.learned_object(), self.model.flight_gravity(self._transitions[0])
        predictor, lag = self.model.simulator(), self.model.measurement.velocity_lag
        if learned.n_joints:
            train, validation = (
                make_stretches(learned, tosses, predictor, steps=horizon, velocity_lag=lag) for tosses in self._tosses
            )
            return train, validation
        if self._flights is None or self._flights.outdated(learned, gravity):
            frames = self.settings.rollouts.min_flight_frames
            fitted = tuple(
                flight_starts(learned, tosses, gravity=gravity, min_frames=frames) for tosses in self._tosses
            )
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
        """Everything that is needed to go on: tensors, numbers and text only."""
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
        """Go on from `state_dict()` of an equal fit.

        Args:
            state: Tensors, numbers and text.
        """
        self.stage, self.epoch, self.stale = state["stage"], state["epoch"], state["stale"]
        self.best_loss, self.best = state["best_loss"], state["best"]
        self.model.load_state_dict(state["model"])
        self._current = None
        if state["current"] is not None and self.stage < len(self.stages):
            self._current = self._make(self.stages[self.stage])
            self._current.load_state_dict(state["current"])

    def epochs(self) -> Iterator[EpochRecord]:
        """Fit, one record an epoch.

        Yields:
            The record of each epoch.

        Raises:
            DivergedError: The loss became NaN or infinite; the state before it is attached.
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
        better = now.validation_loss < self.best_loss * (1 - self.settings.least_improvement)
        if better:
            self.best_loss, self.best, self.stale = now.validation_loss, copy.deepcopy(self.model.state_dict()), 0
        else:
            self.stale += 1
        self.epoch += 1
        record = EpochRecord(
            stage.name, self.epoch, now.train_loss, now.validation_loss, now.parts, now.passes, seconds, better
        )
        return record, now.done
