"""What can be rolled out and judged: a simulator with a model's numbers, or a network."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from tossid.physics import Simulation, System, simulate
from tossid.physics.free import free_acceleration
from tossid.physics.tree import make_work

Array = NDArray[np.float64]

SUBSTEPS = 4
"""Steps of the simulator a frame, in training and in evaluation."""


class Predictor(Protocol):
    """Predicts motion from initial states."""

    def rollout(
        self, q0: Array, v0: Array, *, n_steps: int | NDArray[np.int64], dt: float, n_threads: int = 1
    ) -> Simulation:
        """Roll out (B, nq), (B, nv) for n_steps frames of length dt [s]; see `physics.Simulation`."""

    def acceleration(self, q: Array, v: Array) -> Array:
        """(N, nv) without contact, at (N, nq), (N, nv), in v's frames [m/s², rad/s²]."""


@dataclass(frozen=True)
class Simulator:
    """The time-stepping simulator with the numbers of `system`."""

    system: System
    substeps: int = SUBSTEPS

    def rollout(
        self, q0: Array, v0: Array, *, n_steps: int | NDArray[np.int64], dt: float, n_threads: int = 1
    ) -> Simulation:
        """Roll out; see `physics.simulate`."""
        return simulate(self.system, q0, v0, n_steps=n_steps, dt=dt, substeps=self.substeps, n_threads=n_threads)

    def acceleration(self, q: Array, v: Array) -> Array:
        """M^-1 k of the given and the learned continuous dynamics (N, nv)."""
        work, out = make_work(self.system), np.empty((len(q), self.system.nv))
        for i in range(len(q)):
            free_acceleration(self.system, q[i], v[i], work, out[i])
        return out
