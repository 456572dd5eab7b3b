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
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, replace
from functools import partial
from typing import Any

import numpy as np
import torch

from tossid.errors import DivergedError, ObjectError
from tossid.models.protocol import Array, Corners, DynamicsModel, Objective, StagePlan
from tossid.models.shots import Shots, first_states, make_shots, make_stretches
from tossid.models.trained import EpochRecord
from tossid.models.transitions import Transitions, make_transitions
from tossid.objects import ObjectModel
from tossid.objects.shape_evidence import ShapeEvidence
from tossid.settings.training import TrainSettings
from tossid.training.flights import Flights, FlightStage, fit_flights
from tossid.training.losses import LossStage, Stage
from tossid.training.restarts import UNDETERMINED, Following, Restart, judging_frames, with_shown_corners
from tossid.training.rollouts import RolloutStage
from tossid.training.unknown import UnknownObject
from tossid.types import Toss


class Fit:
    """A fit in progress.

    Args:
        model: Fitted in place; holds the best parameters when `epochs` is exhausted.
        train: Tosses to learn from, as recorded.
        validation: Other tosses, which end the stages.
        settings: How long and how carefully.
        shown: What the tosses showed of an unknown object, from which the model starts.
        size: What the tosses say against the object's stated size (`stated_size`).
        leak: What the splits leak by copies (`tossid.motion.sessions.copies`).

    Attributes:
        evidence: The frames against which corners are held, those of validation tosses among them, or why there are
            none.
        near: The object that says which frames may involve contact: the model's, unless tosses contradict its corners.
        restarts: What was started again.
        way: Corners before training and after each stage that moved them, each (n_c, 3) as lists [m].
    """

    def __init__(
        self,
        model: DynamicsModel,
        train: Sequence[Toss],
        validation: Sequence[Toss],
        settings: TrainSettings | None = None,
        *,
        shown: UnknownObject | None = None,
        size: dict[str, Any] | None = None,
        leak: str | None = None,
    ) -> None:
        self.model = model
        self.shown, self.size, self.leak = shown, size, leak
        self.settings = settings or TrainSettings()
        self.train_tosses = tuple(train)
        true = model.measurement.true_toss
        self._tosses = (tuple(true(toss) for toss in train), tuple(true(toss) for toss in validation))
        self.evidence: ShapeEvidence | str = "a round shape is not held against the hull of its frames"
        self._source: ShapeEvidence | str = self.evidence
        if model.object.roundness is None:
            known = None if shown is None else shown.shapes[0]
            self.evidence, self._source = judging_frames(*self._tosses, self.settings, known)
        self.restarts: list[Restart] = []
        self.way = [model.learned_object().corner_pos.tolist()]
        self._before: tuple[float, dict[str, Any]] | None = None
        self._following: Following | None = None
        self._rival: tuple[list[float], list[float], dict[str, Any]] | None = None
        self.near = self._geometry_of_contact(model.object)
        self._transitions = tuple(
            make_transitions(self.near, tosses, self.settings.transitions) for tosses in self._tosses
        )
        self._n_threads = self.settings.threads or os.cpu_count() or 1
        self.stages = model.stages()
        self.stage = 0
        self.epoch = 0
        self.stale = 0
        self.best_loss = float("inf")
        self.best = _state_of(model)
        self._current: Stage | None = None
        self._holds = False
        self._flights: Flights | None = None

    @property
    def most_epochs(self) -> int:
        """How many epochs there can be."""
        most = {Objective.ROLLOUT: self.settings.rollouts.epochs}
        return sum(most.get(plan.objective, self.settings.epochs) for plan in self.stages)

    @property
    def true_tosses(self) -> tuple[Toss, ...]:
        """The tosses to learn from, with true lengths and velocities."""
        return self._tosses[0]

    def _geometry_of_contact(self, start: ObjectModel) -> ObjectModel:
        """The object that says which frames may involve contact: the start, unless tosses contradict its corners."""
        if isinstance(self._source, str) or not self._contradicts(start.corner_pos):
            return start
        return with_shown_corners(start, self._source)

    def _contradicts(self, corners: Array) -> bool:
        return not isinstance(self.evidence, str) and self.evidence.contradiction(corners) is not None

    def _contradicted(self, corners: Corners | None) -> bool:
        return corners is not None and self._contradicts(corners().detach().numpy())

    def _make(self, plan: StagePlan) -> Stage:
        """A stage, when its turn comes: it starts from the model as it is then."""
        make: dict[Objective, Callable[[StagePlan], Stage]] = {
            Objective.FLIGHT_LOSS: partial(
                self._loss_stage, choose=Transitions.in_flight if self.near is self.model.object else Transitions.free
            ),
            Objective.FLIGHT: lambda plan: FlightStage(plan, self.model, self._tosses, self.settings),
            Objective.LOSS: self._loss_stage,
            Objective.ROLLOUT: self._rollout_stage,
        }
        return make[plan.objective](plan)

    def _loss_stage(self, plan: StagePlan, choose: Callable[[Transitions], Transitions] = lambda t: t) -> LossStage:
        train, validation = (choose(transitions) for transitions in self._transitions)
        if self._holds:
            free = [p for p in plan.parameters if all(p is not held for held in plan.held)]
            plan = replace(plan, parameters=free)
        return LossStage(plan, self.model, train, validation, self.settings)

    def _rollout_stage(self, plan: StagePlan) -> RolloutStage:
        make = partial(self._shots, plan.horizon)
        settings, last = self.settings, plan.horizon == self.stages[-1].horizon
        return RolloutStage(
            plan,
            self.model,
            make,
            settings.rollouts,
            restarts=settings.restarts,
            settles=last and self.model.object.n_joints == 0,
            n_threads=self._n_threads,
        )

    def longest_rollout(self) -> RolloutStage | None:
        """The last stage at the model's present parameters, if it is one of rollouts; None otherwise."""
        last = self.stages[-1] if self.stages else None
        return None if last is None or last.objective is not Objective.ROLLOUT else self._rollout_stage(last)

    def friction_contradicted(self, horizon: int) -> bool:
        """Whether rollouts with another friction are clearly better than with the model's.

        Args:
            horizon: Frames after first contact.
        """
        friction = getattr(self.model, "friction", None)
        if friction is None:
            return False
        stage = self._rollout_stage(StagePlan("friction", Objective.ROLLOUT, [], horizon))
        mu, limits = float(friction().detach()), self.settings.restarts
        now, *others = (stage.loss_with(friction, factor * mu) for factor in (1.0, *limits.friction_factors))
        friction.move(mu)
        return min(others) < limits.better_share * now

    def _shots(self, horizon: int) -> tuple[Shots, Shots]:
        learned, gravity = self.model.learned_object(), self.model.flight_gravity(self._transitions[0])
        predictor, lag = self.model.simulator(), self.model.measurement.velocity_lag
        if learned.n_joints:
            train, validation = (
                make_stretches(learned, tosses, predictor, steps=horizon, velocity_lag=lag) for tosses in self._tosses
            )
            return train, validation
        if self._flights is None or self._flights.outdated(learned, gravity):
            self._flights = fit_flights(learned, self._tosses, gravity, self.settings.rollouts)
        firsts = (first_states(tosses, learned, predictor, velocity_lag=lag) for tosses in self._tosses)
        train, validation = (
            make_shots(learned, tosses, horizon=horizon, first=first, flight=flight)
            for tosses, first, flight in zip(self._tosses, firsts, self._flights.fitted, strict=True)
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
            "restarts": [asdict(restart) for restart in self.restarts],
            "before": self._before,
            "following": None if self._following is None else asdict(self._following),
            "holds": self._holds,
            "way": self.way,
            "rival": self._rival,
            "model": _state_of(self.model),
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
        self.restarts = [Restart(**restart) for restart in state["restarts"]]
        self._before, self._holds, self.way = state["before"], state["holds"], state["way"]
        self._rival = state["rival"]
        self._following = None if state["following"] is None else Following(**state["following"])
        self._current = None
        if state["current"] is not None and self.stage < len(self.stages):
            self._current = self._make(self._plan())
            self._current.load_state_dict(state["current"])

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
                self._holds = bool(plan.held) and self._contradicted(plan.corners)
                self._current = self._make(plan)
                self._current.begin()
                if plan.judged:
                    self.best_loss, self.best = self._current.validation_loss(), _state_of(self.model)
                if isinstance(self._current, RolloutStage) and self._current.friction_restarted:
                    self.restarts.append(Restart(plan.name, "friction", 1, kept=True))
            done = False
            patience = self.settings.patience if self._following is None else Following.PATIENCE
            while not done and self.epoch < self._current.epochs and self.stale < patience:
                record, done = self._step(self._current)
                if done:
                    self.epoch = self._current.epochs
                yield record
            self.model.load_state_dict(self.best)
            if isinstance(self._current, RolloutStage):
                self._against_rival(plan, self._current)
            corners = self._learned_by(plan).corner_pos.tolist()
            if corners != self.way[-1]:
                self.way.append(corners)
            self.stage += 0 if self._again(plan) else 1
            self.epoch, self.stale, self.best_loss, self._current = 0, 0, float("inf"), None

    def _against_rival(self, plan: StagePlan, stage: RolloutStage) -> None:
        """Note what a rival leaves; after the last stage, return to it unless the model is clearly better."""
        if plan.rival:
            train, validation = stage.losses_by_toss()
            self._rival = train.tolist(), validation.tolist(), _state_of(self.model)
        elif self._rival is not None and self.stage + 1 == len(self.stages):
            *losses, simple = self._rival
            if not stage.clearly_better((np.array(losses[0]), np.array(losses[1]))):
                self.model.load_state_dict(simple)
                moved = sum(parameter.numel() for parameter in plan.parameters)
                self.restarts.append(Restart(plan.name, UNDETERMINED, moved, kept=False))

    def _plan(self) -> StagePlan:
        """The present stage, with the gap's width of the present pass."""
        plan, following = self.stages[self.stage], self._following
        if plan.widen is not None:
            plan.widen(1.0 if following is None else following.widths[0])
        return plan if following is None else replace(plan, name=f"{plan.name}-gap-{following.widths[0]:g}")

    def _again(self, plan: StagePlan) -> bool:
        """Whether the stage that has ended is to be gone through again."""
        if self._following is None:
            return self._start_again(plan) or self._follow(plan)
        self._following.widths.pop(0)
        if self._following.widths:
            return True
        if self._following.ends_at > self.settings.restarts.followed_loss * self._following.loss:
            self.model.load_state_dict(self._following.before)
            self.restarts[-1] = replace(self.restarts[-1], kept=False)
        self._following = None
        return False

    def _follow(self, plan: StagePlan) -> bool:
        """Whether corners that were started again are now followed to an end that does not depend on the start.

        With the narrow gap alone the loss has minima a millimetre apart, and validation tosses end the stage on the way
        to one of them. All corners begin where the tosses show them, and the loss narrows pass by pass.
        """
        widths, limits = list(self.settings.restarts.gap_widths), self.settings.restarts
        again = any(restart.what == "corners" and restart.kept for restart in self.restarts)
        if not (again and widths and plan.widen is not None) or isinstance(self._source, str):
            return False
        assert plan.corners is not None
        now = plan.corners().detach().numpy().copy()
        moved = self._source.corrected(now, every=True)
        changed = int((moved != now).any(axis=1).sum())
        if not changed or limits.corners == 0:
            return False
        self.restarts.append(Restart(plan.name, "all corners", changed, kept=True))
        self._following = Following(widths, self.best_loss, _state_of(self.model))
        plan.corners.move(moved)
        return True

    def _start_again(self, plan: StagePlan) -> bool:
        """Whether the stage that has ended is to be gone through again, with corners that were started again.

        A pass with corners started again counts if its validation loss is lower than that of the pass before.
        """
        if self._before is not None:
            loss, before = self._before
            self._before = None
            if self.best_loss >= loss:
                self.model.load_state_dict(before)
                self.restarts[-1] = replace(self.restarts[-1], kept=False)
                return False
        tried = sum(restart.what == "corners" for restart in self.restarts)
        if tried >= self.settings.restarts.corners or not self._contradicted(plan.corners):
            return False
        assert plan.corners is not None
        if isinstance(self._source, str):
            return False
        now = plan.corners().detach().numpy().copy()
        moved = self._source.corrected(now)
        changed = int((moved != now).any(axis=1).sum())
        if not changed:
            return False
        self._before = (self.best_loss, _state_of(self.model))
        self.restarts.append(Restart(plan.name, "corners", changed, kept=True))
        plan.corners.move(moved)
        return True

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

    def _step(self, stage: Stage) -> tuple[EpochRecord, bool]:
        before = _state_of(self.model)
        started = time.perf_counter()
        now = stage.step()
        seconds = time.perf_counter() - started
        if now.train_loss - now.train_loss != 0.0 or now.validation_loss != now.validation_loss:
            raise DivergedError(
                f"the loss became {now.train_loss} in stage '{stage.name}', epoch {self.epoch}", state=before
            )
        loss, least = now.validation_loss, self.settings.least_improvement
        if self._following is not None:
            self._following.ends_at = loss
            loss, least = now.train_loss, self.settings.restarts.followed_to
        # steps of rollouts go to a root, about which losses, of validation tosses, too, are rough
        better = isinstance(stage, RolloutStage) or loss < self.best_loss * (1 - least)
        if better:
            self.best_loss, self.best, self.stale = loss, _state_of(self.model), 0
        else:
            self.stale += 1
        self.epoch += 1
        record = EpochRecord(
            stage.name, self.epoch, now.train_loss, now.validation_loss, now.parts, now.passes, seconds, better
        )
        return record, now.done


def _state_of(model: DynamicsModel) -> dict[str, Any]:
    """A copy of the model's state."""
    state = model.state_dict().items()
    return {name: value.clone() if isinstance(value, torch.Tensor) else copy.deepcopy(value) for name, value in state}
