"""What can be rolled out: a simulator with a model's numbers, a network, or anything with these two methods."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from tossid.physics import ExactCone, Simulation, System, simulate
from tossid.physics.batch import free_accelerations
from tossid.physics.mujoco_engine import LIFTING
from tossid.physics.solvers.registry import ContactSolver
from tossid.settings.training import ModelSettings

Array = NDArray[np.float64]


class Predictor(Protocol):
    """Predicts motion from a first state."""

    @property
    def corner_pos(self) -> Array | None:
        """(n_c, 3) corners in their bodies' frames [m]; None for a predictor that has no geometry."""

    def rollout(
        self, q0: Array, v0: Array, *, n_steps: int | NDArray[np.int64], dt: float, n_threads: int = 1
    ) -> Simulation:
        """Roll out first states.

        Args:
            q0: (B, nq).
            v0: (B, nv).
            n_steps: Frames to predict, for all or for each.
            dt: Length of a frame [s].
            n_threads: For the batch.
        """

    def acceleration(self, q: Array, v: Array) -> Array:
        """(N, nv) without contact, at (N, nq), (N, nv), in v's frames [m/s², rad/s²]."""


@dataclass(frozen=True)
class Simulator:
    """The time-stepping simulator with certain numbers.

    Attributes:
        system: The numbers.
        substeps: Steps a frame.
        impact_parts: As of `physics.simulate`, where contact is rigid. Where it yields, impacts last for some steps.
        solver: Of contact.
    """

    system: System
    substeps: int = ModelSettings.substeps
    impact_parts: int = ModelSettings.impact_parts
    solver: ContactSolver = ExactCone()

    @property
    def corner_pos(self) -> Array:
        """(n_c, 3) corners in their bodies' frames [m]."""
        return self.system.corner_pos

    def relaxed(self) -> Simulator | None:
        """This simulator with the convex relaxation of Coulomb's law, as MuJoCo has it: what slips is lifted.

        None where the solver has no such law.
        """
        if not isinstance(self.solver, ExactCone):
            return None
        return replace(self, system=self.system._replace(law=self.system.law._replace(lifting=LIFTING)))

    def rollout(
        self, q0: Array, v0: Array, *, n_steps: int | NDArray[np.int64], dt: float, n_threads: int = 1
    ) -> Simulation:
        """Roll out first states; see `physics.simulate`.

        Args:
            q0: (B, nq).
            v0: (B, nv).
            n_steps: Frames to predict, for all or for each.
            dt: Length of a frame [s].
            n_threads: For the batch.
        """
        rigid = self.system.compliance == 0.0 and self.system.relaxation == 0.0
        return simulate(
            self.system,
            q0,
            v0,
            n_steps=n_steps,
            dt=dt,
            substeps=self.substeps,
            impact_parts=self.impact_parts if rigid else 1,
            solver=self.solver,
            n_threads=n_threads,
        )

    def acceleration(self, q: Array, v: Array) -> Array:
        """M^-1 k of the given and the learned continuous dynamics (N, nv)."""
        return free_accelerations(self.system, q, v)
