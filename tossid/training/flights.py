"""What free flight shows: first states of tosses, and the body and gravity."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import nn

from tossid.models.protocol import DynamicsModel, StagePlan
from tossid.motion import FlightState, flight_states
from tossid.objects import ObjectModel
from tossid.settings.training import TrainSettings
from tossid.training.losses import Pass
from tossid.training.rollouts import LARGEST_STEP
from tossid.types import Toss

Array = NDArray[np.float64]


MIN_FLIGHT_FRAMES = 4
"""Frames before first contact from which a first state is also estimated from the flight."""
COM_REL, INERTIA_REL, GRAVITY_REL = 1e-3, 0.01, 1e-3
"""Changes (in widths, and relative) on which first states do not depend."""


@dataclass(frozen=True)
class FirstStates:
    """First states that flights gave, for a model as it was.

    Attributes:
        model: The object then.
        gravity: In flight [m/s²].
        states: Of training and of validation tosses; None where there is too little flight.
    """

    model: ObjectModel
    gravity: float
    states: tuple[list[FlightState | None], ...]

    def outdated(self, model: ObjectModel, gravity: float) -> bool:
        """Whether flights would give other first states now.

        Args:
            model: The object now.
            gravity: In flight [m/s²].
        """
        return bool(
            np.abs(model.com - self.model.com).max() > COM_REL * model.width
            or np.abs(model.inertia - self.model.inertia).max() > INERTIA_REL * np.abs(self.model.inertia).max()
            or abs(gravity - self.gravity) > GRAVITY_REL * max(abs(gravity), 1.0)
        )


def first_states_of_flights(model: ObjectModel, tosses: Sequence[Sequence[Toss]], gravity: float) -> FirstStates:
    """First states of sets of tosses as their flights give them.

    Args:
        model: The object as it is estimated: its centre of mass flies, its corners touch first.
        tosses: Of training and of validation, with true lengths.
        gravity: In flight [m/s²].
    """
    found = (flight_states(each, model, gravity=gravity) for each in tosses)
    enough = tuple([state if state.n_frames >= MIN_FLIGHT_FRAMES else None for state in each] for each in found)
    return FirstStates(model, gravity, enough)


class FlightStage:
    """What free flight shows of a rigid body, by maximum likelihood (Gauss-Newton).

        loss = mean over flights of rho(chi²),   rho(c) = c up to 1, 1 + log c beyond

    with chi² the squared misfit of a flight's measured poses, weighted by their covariances, per degree of freedom.
    Each flight has its own first state (`motion.flight_states`); centre of mass, inertia and gravity are those of all.
    Beyond 1, the noise is larger than stated, and is taken as it shows itself: a flight in a hand hardly counts.

    The size of inertia has no part in flight. Numbers that flight leaves open stay near their start, from which each
    has a standard deviation of one unit.

    Args:
        plan: Learns the inertia, and the uniform vertical part of the learned acceleration as its `quadratic`.
        model: Changed in place.
        tosses: Of training and of validation, with true lengths.
        settings: Most epochs.
    """

    DIFFERENCE = 1e-5
    """Step of the differences, in the parameters' own units of order one. They go to one side: with a longer step,
    their error would move the size of inertia, which flight does not determine."""
    SHORT_STEP = 0.3
    """Step in standard errors (the largest of all parameters) below which the stage ends; the next is far shorter."""

    def __init__(
        self, plan: StagePlan, model: DynamicsModel, tosses: Sequence[Sequence[Toss]], settings: TrainSettings
    ) -> None:
        self.name, self.epochs = plan.name, settings.epochs
        self._plan, self._model, self._tosses = plan, model, tosses
        self._start = self._get()
        self._gravity = np.concatenate([np.full(p.numel(), p is plan.quadratic) for p in plan.parameters])

    def begin(self) -> None:
        """Put gravity where the flights of the body as it is have it."""
        for _ in range(2):  # the loss is quadratic in it, but for the weights of flights
            self._improve(self._gravity)

    def step(self) -> Pass:
        """One step of Gauss-Newton."""
        done = self._improve(np.full(len(self._start), True))
        loss = _robust_mean(self._flights(0))
        return Pass(loss, self.validation_loss(), {"flight": loss}, len(self._start) + 2, done)

    def validation_loss(self) -> float:
        """The loss of validation tosses' flights."""
        return _robust_mean(self._flights(1))

    def _improve(self, free: NDArray[np.bool_]) -> bool:
        """A step along some of the parameters; whether it was short."""
        x, columns, by = self._get(), np.flatnonzero(free), self.DIFFERENCE
        flights = self._flights(0)
        if not flights or not len(columns):
            return True
        r = np.stack([state.residuals for state in flights])
        J = np.empty((*r.shape, len(columns)))
        for k, j in enumerate(columns):
            self._put(x + by * (np.arange(len(x)) == j))
            J[..., k] = (np.stack([state.residuals for state in self._flights(0)]) - r) / by
        # rho'(c) of the robust loss: 1 up to 1, and 1/c beyond
        weight = 1 / np.maximum(1.0, [state.chi2 for state in flights])
        prior = np.where(self._gravity, 1e-12, 1.0)[columns]
        H = np.einsum("t,tnj,tnk->jk", weight, J, J) + np.diag(prior)
        g = np.einsum("t,tnj,tn->j", weight, J, r) + prior * (x - self._start)[columns]
        step = -np.linalg.solve(H, g)
        limit = np.where(self._gravity, np.inf, LARGEST_STEP)[columns]
        x[columns] += np.clip(step, -limit, limit)
        self._put(x)
        return bool((np.abs(step) < self.SHORT_STEP * np.sqrt(np.diag(np.linalg.inv(H)))).all())

    def _flights(self, split: int) -> list[FlightState]:
        """The flights of training (0) or validation tosses (1), with the model as it is; none without flight."""
        mechanics = self._model.mechanics()
        assert mechanics is not None
        states = flight_states(self._tosses[split], mechanics.object, gravity=mechanics.carried_gravity)
        return [state for state in states if state.n_frames]

    def _get(self) -> Array:
        return nn.utils.parameters_to_vector(self._plan.parameters).detach().numpy().copy()

    def _put(self, x: Array) -> None:
        with torch.no_grad():
            nn.utils.vector_to_parameters(torch.from_numpy(x.copy()), self._plan.parameters)

    def state_dict(self) -> dict[str, Any]:
        """Where the stage began."""
        return {"start": self._start.tolist()}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Go on from `state_dict()` of an equal stage.

        Args:
            state: Numbers.
        """
        self._start = np.array(state["start"])


def _robust_mean(flights: Sequence[FlightState]) -> float:
    """Mean of rho(chi²) over flights; 0 of none."""
    chi2 = np.array([flight.chi2 for flight in flights])
    return float(np.where(chi2 > 1, 1 + np.log(np.maximum(chi2, 1)), chi2).mean()) if len(chi2) else 0.0
