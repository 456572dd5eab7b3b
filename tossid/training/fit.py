"""The fit loop: stage by stage, those of the implicit loss stopped early on validation tosses.

The model names its stages (`models.protocol.StagePlan`); for ContactNets these are

1. "flight": centre of mass, ratios of inertia and gravity, by the likelihood of poses in flight.
2. "continuous": the learned acceleration, by the implicit loss on transitions that surely involve no contact. Learned
   together with contact, impulses at rest would stand in for missing gravity.
3. "contact": geometry and friction, by the implicit loss on all transitions, and then "inertia": these and the inertia.
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
from dataclasses import asdict, replace
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

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
from tossid.training.restarts import (
    GAP_WIDTHS,
    LARGEST_RISE,
    TRAINING_END,
    TRAINING_PATIENCE,
    UNDETERMINED,
    Restart,
    Retry,
    judging_frames,
    with_shown_corners,
)
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
        corner_history: Corners before training and after each stage that moved them, each (n_c, 3) as lists [m].
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
        self._shown_corners: ShapeEvidence | str = self.evidence
        if model.object.roundness is None:
            known, rationed = None if unknown is None else unknown.shapes[0], self.settings.tosses is not None
            self.evidence, self._shown_corners = judging_frames(*self._tosses, known, rationed=rationed)
        self.contact_geometry = model.object
        if not isinstance(self._shown_corners, str) and self._contradicted(model.object.corner_pos):
            self.contact_geometry = with_shown_corners(model.object, self._shown_corners)
        self.transitions = tuple(make_transitions(self.contact_geometry, tosses) for tosses in self._tosses)
        self.restarts: list[Restart] = []
        self.corner_history = [model.learned_object().corner_pos.tolist()]
        self.stages = model.stages()
        self.stage = self.epoch = self.stale = 0
        self.best_loss, self.best = float("inf"), _state_of(model)
        self._retry: Retry | None = None
        self._rival: tuple[list[float], list[float], dict[str, Any]] | None = None
        self._current: Stage | None = None
        self._holds_inertia = False
        self._flights: FirstStates | None = None

    @property
    def most_epochs(self) -> int:
        """How many epochs there can be."""
        rollouts, losses = self.settings.rollouts.epochs, self.settings.epochs
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
            plan = self._plan()
            if self._current is None:
                self._begin(plan)
            stage, done = self._current, False
            assert stage is not None
            patience = TRAINING_PATIENCE if self._retry and self._retry.follows_training else self.settings.patience
            while not done and self.epoch < stage.epochs and self.stale < patience:
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
            self.stage += 0 if self._begin_another_pass(plan) else 1
            self.epoch, self.stale, self.best_loss, self._current = 0, 0, float("inf"), None

    def _begin(self, plan: StagePlan) -> None:
        """Make a stage and begin it: it starts from the model as it is now."""
        self._holds_inertia = bool(plan.held) and self._learned_corners_contradicted(plan)
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
        loss, least = now.validation_loss, LEAST_IMPROVEMENT
        if self._retry is not None and self._retry.follows_training:
            self._retry.loss = loss
            loss, least = now.train_loss, TRAINING_END
        # steps of rollouts go to a root, about which losses, of validation tosses, too, are rough
        better = isinstance(stage, RolloutStage) or loss < self.best_loss * (1 - least)
        if better:
            self.best_loss, self.best, self.stale = loss, _state_of(self.model), 0
        else:
            self.stale += 1
        self.epoch += 1
        losses = (now.train_loss, now.validation_loss)
        return EpochRecord(stage.name, self.epoch, *losses, now.parts, now.passes, seconds, better), now.done

    def _plan(self) -> StagePlan:
        """The present stage, with the gap's width of the present pass."""
        plan, width = self.stages[self.stage], None
        if self._retry is not None and self._retry.follows_training:
            width = self._retry.gap_widths[0]
        if plan.widen_gap is not None:
            plan.widen_gap(width or 1.0)
        return plan if width is None else replace(plan, name=f"{plan.name}-gap-{width:g}")

    # ------------------------------------------------------------------------------------------- stages by objective

    def _make(self, plan: StagePlan) -> Stage:
        if plan.objective is Objective.ROLLOUT:
            settles = plan.horizon == self.stages[-1].horizon and self.model.object.n_joints == 0
            prediction = self._prediction(plan)
            return RolloutStage(plan, prediction, self.settings.rollouts, settles=settles)
        if plan.objective is Objective.FLIGHT:
            return FlightStage(plan, self.model, self._tosses, self.settings)
        train, validation = self.transitions
        if plan.objective is Objective.FLIGHT_LOSS:
            choose = Transitions.in_flight if self.contact_geometry is self.model.object else Transitions.free
            train, validation = choose(train), choose(validation)
        if self._holds_inertia:
            learned = [p for p in plan.parameters if all(p is not held for held in plan.held)]
            plan = replace(plan, parameters=learned)
        return LossStage(plan, self.model, train, validation, self.settings)

    def _prediction(self, plan: StagePlan) -> PredictionError:
        return PredictionError(
            self.model,
            plan.parameters,
            lambda: self._shots(plan.horizon),
            self.settings.rollouts,
            n_threads=self._n_threads,
        )

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

    # ------------------------------------------------------------------- what is started again, undone or gone through

    def _contradicted(self, corners: NDArray[np.float64]) -> bool:
        return not isinstance(self.evidence, str) and self.evidence.contradiction(corners) is not None

    def _learned_corners_contradicted(self, plan: StagePlan) -> bool:
        return plan.corners is not None and self._contradicted(plan.corners().detach().numpy())

    def _begin_another_pass(self, plan: StagePlan) -> bool:
        """Prepare another pass through a stage that has ended; False if there is none.

        A pass with contradicted corners started again counts if its validation loss is lower than that of the pass
        before. Once no corner is contradicted any more, all are followed to an end that does not depend on the start.
        """
        retry, self._retry = self._retry, None
        if retry is None:
            return self._restart_corners(plan) or self._follow_all_corners(plan)
        if len(retry.gap_widths) > 1:
            self._retry = replace(retry, gap_widths=retry.gap_widths[1:])
            return True
        loss = retry.loss if retry.follows_training else self.best_loss
        undone = loss >= retry.most_loss
        if undone:
            self.model.load_state_dict(retry.before)
            self.restarts[-1] = replace(self.restarts[-1], kept=False)
        if retry.follows_training:
            return False
        return (not undone and self._restart_corners(plan)) or self._follow_all_corners(plan)

    def _restart_corners(self, plan: StagePlan) -> bool:
        """Move corners that the tosses contradict to where these show corners; False where none moves."""
        tried = sum(restart.what == "corners" for restart in self.restarts)
        if tried >= self.settings.restarts.corners or not self._learned_corners_contradicted(plan):
            return False
        return self._move_corners(plan, Retry([], _state_of(self.model), self.best_loss), every=False)

    def _follow_all_corners(self, plan: StagePlan) -> bool:
        """Move all corners to where the tosses show them, if some were; False where none moves.

        With the narrow gap alone the loss has minima a millimetre apart, and validation tosses end the stage on the way
        to one of them. So the loss narrows pass by pass.
        """
        moved_some = any(restart.what == "corners" and restart.kept for restart in self.restarts)
        if not moved_some or plan.widen_gap is None:
            return False
        retry = Retry(list(GAP_WIDTHS), _state_of(self.model), LARGEST_RISE * self.best_loss)
        return self._move_corners(plan, retry, every=True)

    def _move_corners(self, plan: StagePlan, retry: Retry, *, every: bool) -> bool:
        if isinstance(self._shown_corners, str) or plan.corners is None:
            return False
        now = plan.corners().detach().numpy().copy()
        corners = self._shown_corners.corrected(now, every=every)
        count = int((corners != now).any(axis=1).sum())
        if count == 0:
            return False
        self._retry = retry
        self.restarts.append(Restart(plan.name, "all corners" if every else "corners", count, kept=True))
        plan.corners.move(corners)
        return True

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
            "retry": None if self._retry is None else vars(self._retry),
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
        self._retry = None if state["retry"] is None else Retry(**state["retry"])
        self._current = None
        if state["current"] is not None and self.stage < len(self.stages):
            self._current = self._make(self._plan())
            self._current.load_state_dict(state["current"])


_STATE = ("stage", "epoch", "stale", "best_loss", "best", "corner_history", "_rival", "_holds_inertia")
"""Of a fit, what is plain already."""


def _state_of(model: DynamicsModel) -> dict[str, Any]:
    """A copy of the model's state."""
    state = model.state_dict().items()
    return {name: value.clone() if isinstance(value, torch.Tensor) else copy.deepcopy(value) for name, value in state}
