"""The fit loop: stage by stage, those of the implicit loss stopped early on validation tosses.

The model names its stages (`models.protocol.StagePlan`); for ContactNets these are

1. "flight": centre of mass, ratios of inertia and gravity, by the likelihood of poses in flight.
2. "continuous": the learned acceleration, by the implicit loss on transitions that surely involve no contact. Learned
   together with contact, impulses at rest would stand in for missing gravity.
3. "contact": geometry and friction, by the implicit loss on all transitions, and then "inertia": these and the inertia.
   Corners that the tosses contradict start where these show corners.
4. "rollout-N": friction (and contact law and inertia), by open-loop prediction until N frames after first contact,
   N growing: short predictions are smooth in the parameters from far away, long ones decide the last digits. Of objects
   with joints, over stretches of N frames from everywhere in a toss.

What more freedom gains counts only if validation tosses show it: a judged stage is undone unless they are predicted
better, and all after "contact" is, unless they are predicted clearly better than with friction refined alone.

The loop yields records and knows no tracker. Its state is plain tensors and numbers, so that an interrupted fit goes on
exactly where it was.
"""

from __future__ import annotations

import copy
import os
import time
from collections.abc import Iterator, Sequence
from dataclasses import asdict
from functools import partial
from typing import Any

import numpy as np
import torch

from tossid.errors import DivergedError, ObjectError
from tossid.models.protocol import DynamicsModel, Objective, StagePlan
from tossid.models.shots import Shots, first_states, make_shots, make_stretches
from tossid.models.trained import EpochRecord
from tossid.models.transitions import Transitions, make_transitions
from tossid.objects import ObjectModel
from tossid.objects.shape_evidence import ShapeEvidence
from tossid.settings.training import TrainSettings
from tossid.training.flights import FirstStates, FlightStage, first_states_of_flights
from tossid.training.losses import LossStage, Stage
from tossid.training.prediction import PredictionError
from tossid.training.restarts import UNDETERMINED, Restart, judging_frames, with_shown_corners
from tossid.training.rollouts import RolloutStage, clearly_better
from tossid.training.unknown import UnknownObject
from tossid.types import Toss

LEAST_IMPROVEMENT = 1e-4
"""Relative decrease of the validation loss that counts as better."""


class Fit:
    """A fit in progress.

    Args:
        model: Fitted in place; holds the best parameters when `epochs` is exhausted.
        train: Tosses to learn from, as recorded.
        validation: Other tosses, which end the stages.
        settings: How long and how carefully.
        unknown: What the tosses showed of an unknown object, from which the model starts.
        remarks: What else is to be said of the dataset, by its name among the learned parameters.

    Attributes:
        evidence: The frames against which corners are held, those of validation tosses among them, or why there are
            none.
        contact_geometry: The object that says which frames may involve contact: the model's, unless tosses contradict
            its corners.
        restarts: What was started again.
        corner_history: Corners as given, where they started if that is elsewhere, and after each stage that moved them,
            each (n_c, 3) as lists [m].
    """

    def __init__(
        self,
        model: DynamicsModel,
        train: Sequence[Toss],
        validation: Sequence[Toss],
        settings: TrainSettings | None = None,
        *,
        unknown: UnknownObject | None = None,
        remarks: dict[str, Any] | None = None,
    ) -> None:
        self.model, self.settings = model, settings or TrainSettings()
        self.unknown, self.remarks = unknown, remarks or {}
        self.train_tosses = tuple(train)
        true = model.measurement.true_toss
        self._tosses = (tuple(true(toss) for toss in train), tuple(true(toss) for toss in validation))
        self._n_threads = self.settings.threads or os.cpu_count() or 1
        self.evidence: ShapeEvidence | str = "a round shape is not held against the hull of its frames"
        self.contact_geometry = model.object
        self.stages = model.stages()
        self.restarts: list[Restart] = []
        self.corner_history = [model.learned_object().corner_pos.tolist()]
        if model.object.roundness is None:
            known, rationed = None if unknown is None else unknown.shapes[0], self.settings.tosses is not None
            self.evidence, shown = judging_frames(*self._tosses, known, rationed=rationed)
            contradicted = not isinstance(self.evidence, str) and self.evidence.contradiction(model.object.corner_pos)
            if contradicted and not isinstance(shown, str):
                self.contact_geometry = with_shown_corners(model.object, shown)
                self._start_corners_again(shown)
        self.transitions = tuple(make_transitions(self.contact_geometry, tosses) for tosses in self._tosses)
        self.stage = self.epoch = self.stale = 0
        self.best_loss, self.best = float("inf"), _state_of(model)
        self._rival: tuple[list[float], list[float], dict[str, Any]] | None = None
        self._current: Stage | None = None
        self._flights: FirstStates | None = None

    @property
    def most_epochs(self) -> int:
        """How many epochs there can be."""
        rollouts, losses = self.settings.rollout_epochs, self.settings.epochs
        return sum(rollouts if plan.objective is Objective.ROLLOUT else losses for plan in self.stages)

    @property
    def true_tosses(self) -> tuple[Toss, ...]:
        """The tosses to learn from, with true lengths and velocities."""
        return self._tosses[0]

    def epochs(self) -> Iterator[EpochRecord]:
        """Fit, one record an epoch.

        Yields:
            The record of each epoch.

        Raises:
            DivergedError: The loss became NaN or infinite, or what a stage learned is no body; the state before or
                after it is attached.
        """
        while self.stage < len(self.stages):
            plan = self.stages[self.stage]
            if self._current is None:
                self._begin(plan)
            stage, done = self._current, False
            assert stage is not None
            while not done and self.epoch < stage.epochs and self.stale < self.settings.patience:
                record, done = self._step(stage)
                if done:
                    self.epoch = stage.epochs
                yield record
            self.model.load_state_dict(self.best)
            if isinstance(stage, RolloutStage):
                self._compare_with_rival(plan, stage.prediction)
            corners = self._learned_by(plan).corner_pos.tolist()
            if corners != self.corner_history[-1]:
                self.corner_history.append(corners)
            self.stage += 1
            self.epoch, self.stale, self.best_loss, self._current = 0, 0, float("inf"), None

    def _begin(self, plan: StagePlan) -> None:
        """Make a stage and begin it: it starts from the model as it is now."""
        self._current = stage = self._make(plan)
        stage.begin()
        if plan.judged:
            self.best_loss, self.best = stage.validation_loss(), _state_of(self.model)
        if isinstance(stage, RolloutStage) and stage.friction_restarted:
            self.restarts.append(Restart(plan.name, "friction", 1, kept=True))

    def _step(self, stage: Stage) -> tuple[EpochRecord, bool]:
        """An epoch of a stage; its record, and whether the stage is done."""
        before, started = _state_of(self.model), time.perf_counter()
        now = stage.step()
        seconds = time.perf_counter() - started
        if not np.isfinite(now.train_loss) or np.isnan(now.validation_loss):
            raise DivergedError(
                f"the loss became {now.train_loss} in stage '{stage.name}', epoch {self.epoch}", state=before
            )
        # steps of rollouts go to a root, about which losses, of validation tosses, too, are rough
        better = isinstance(stage, RolloutStage) or now.validation_loss < self.best_loss * (1 - LEAST_IMPROVEMENT)
        if better:
            self.best_loss, self.best, self.stale = now.validation_loss, _state_of(self.model), 0
        else:
            self.stale += 1
        self.epoch += 1
        losses = (now.train_loss, now.validation_loss)
        return EpochRecord(stage.name, self.epoch, *losses, now.parts, now.passes, seconds, better), now.done

    # ------------------------------------------------------------------------------------------- stages by objective

    def _make(self, plan: StagePlan) -> Stage:
        if plan.objective is Objective.ROLLOUT:
            settles = plan.horizon == self.stages[-1].horizon and self.model.object.n_joints == 0
            prediction = self._prediction(plan)
            return RolloutStage(plan, prediction, self.settings.rollout_epochs, settles=settles)
        if plan.objective is Objective.FLIGHT:
            return FlightStage(plan, self.model, self._tosses, self.settings)
        train, validation = self.transitions
        if plan.objective is Objective.FLIGHT_LOSS:
            choose = Transitions.in_flight if self.contact_geometry is self.model.object else Transitions.free
            train, validation = choose(train), choose(validation)
        return LossStage(plan, self.model, train, validation, self.settings)

    def _prediction(self, plan: StagePlan) -> PredictionError:
        shots = partial(self._shots, plan.horizon)
        return PredictionError(self.model, plan.parameters, shots, n_threads=self._n_threads)

    def longest_prediction(self) -> PredictionError | None:
        """The error of the last stage at the model's present parameters, if it is one of rollouts; None otherwise."""
        last = self.stages[-1] if self.stages else None
        return None if last is None or last.objective is not Objective.ROLLOUT else self._prediction(last)

    def _shots(self, horizon: int) -> tuple[Shots, Shots]:
        """Training and validation shots; of objects with joints, short stretches from everywhere in a toss."""
        learned, predictor = self.model.learned_object(), self.model.simulator()
        lag = self.model.measurement.velocity_lag
        if learned.n_joints:
            train, validation = (
                make_stretches(learned, tosses, predictor, steps=horizon, velocity_lag=lag) for tosses in self._tosses
            )
            return train, validation
        gravity = self.model.flight_gravity(self.transitions[0])
        if self._flights is None or self._flights.outdated(learned, gravity):
            self._flights = first_states_of_flights(learned, self._tosses, gravity)
        firsts = (first_states(tosses, learned, predictor, velocity_lag=lag) for tosses in self._tosses)
        train, validation = (
            make_shots(learned, tosses, horizon=horizon, first=first, flight=flight)
            for tosses, first, flight in zip(self._tosses, firsts, self._flights.states, strict=True)
        )
        return train, validation

    # --------------------------------------------------------------------------------- what is started again, or undone

    def _start_corners_again(self, shown: ShapeEvidence) -> None:
        """Move corners that a stage learns, and that the tosses contradict, to where these show corners.

        A corner inside the body never touches alone, so that the implicit loss has no gradient for it. The corners that
        are right are moved, too: the end then does not depend on where training was to start.
        """
        plan = next((plan for plan in self.stages if plan.corners is not None), None)
        if plan is None or plan.corners is None or not self.settings.restart_corners:
            return
        now = plan.corners().detach().numpy().copy()
        corners = shown.corrected(now)
        if moved := int((corners != now).any(axis=1).sum()):
            plan.corners.move(corners)
            self.restarts.append(Restart(plan.name, "corners", moved, kept=True))
            self.corner_history.append(self.model.learned_object().corner_pos.tolist())

    def _compare_with_rival(self, plan: StagePlan, prediction: PredictionError) -> None:
        """Note what a rival leaves; after the last stage, return to it unless the model is clearly better."""
        if plan.rival:
            train, validation = prediction.mean_losses()
            self._rival = train.tolist(), validation.tolist(), _state_of(self.model)
        elif self._rival is not None and self.stage + 1 == len(self.stages):
            *losses, simple = self._rival
            if not clearly_better(prediction.mean_losses(), (np.array(losses[0]), np.array(losses[1]))):
                self.model.load_state_dict(simple)
                moved = sum(parameter.numel() for parameter in plan.parameters)
                self.restarts.append(Restart(plan.name, UNDETERMINED, moved, kept=False))

    def _learned_by(self, plan: StagePlan) -> ObjectModel:
        """The object as a stage left it.

        Raises:
            DivergedError: It is none that could be simulated.
        """
        try:
            return self.model.learned_object()
        except ObjectError as error:
            raise DivergedError(
                f"stage '{plan.name}' ran away from every body that there is: {error}; more epochs than {self.epoch}, "
                "more tosses or a start that is nearer (gravity, inertia) may help",
                state=_state_of(self.model),
            ) from error

    # ---------------------------------------------------------------------------------------------------- resumption

    def state_dict(self) -> dict[str, Any]:
        """Everything that is needed to go on: tensors, numbers and text only."""
        return {
            **{name: getattr(self, name) for name in _STATE},
            "restarts": [asdict(restart) for restart in self.restarts],
            "model": _state_of(self.model),
            "current": None if self._current is None else self._current.state_dict(),
        }

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Go on from `state_dict()` of an equal fit.

        Args:
            state: Tensors, numbers and text.
        """
        for name in _STATE:
            setattr(self, name, state[name])
        self.model.load_state_dict(state["model"])
        self.restarts = [Restart(**restart) for restart in state["restarts"]]
        self._current = None
        if state["current"] is not None and self.stage < len(self.stages):
            self._current = self._make(self.stages[self.stage])
            self._current.load_state_dict(state["current"])


_STATE = ("stage", "epoch", "stale", "best_loss", "best", "corner_history", "_rival")
"""Of a fit, what is plain already."""


def _state_of(model: DynamicsModel) -> dict[str, Any]:
    """A copy of the model's state."""
    state = model.state_dict().items()
    return {name: value.clone() if isinstance(value, torch.Tensor) else copy.deepcopy(value) for name, value in state}
