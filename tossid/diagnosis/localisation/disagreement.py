"""What exact solvers of the same rigid body disagree on: a gap of that size is no evidence against a simulator.

Where several corners hit or slide at once, rigid bodies with Coulomb friction have no unique motion. Impacts may be
resolved one after another, each where it happens, as tossid's simulator does, or all that fall into a time step at once
(Stewart and Trinkle 1996). Both solve the same contact problem exactly. Here the second makes the motions, they are
measured with noise, and the hypothesis is judged on them like on tosses.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tossid.diagnosis.likelihood.states import difference
from tossid.diagnosis.localisation.misspecification import left_of
from tossid.diagnosis.selection.cross_validation import Candidate, CrossValidator

Array = NDArray[np.float64]


@dataclass(frozen=True)
class SolverDisagreement:
    """The gap that another exact solver of the same rigid body shows.

    Attributes:
        gap: Root mean square of whitened residuals of its motions.
        position_mm: Distance of both solvers' motions at the end of a window in contact, 95 % quantile [mm].
        rotation_deg: Angle, likewise [deg].
    """

    gap: float
    position_mm: float
    rotation_deg: float

    def as_json(self) -> dict[str, Any]:
        """gap.json's "solver_disagreement"."""
        return {"gap": self.gap, "position_mm": self.position_mm, "rotation_deg": self.rotation_deg}


def solver_disagreement(state: Candidate, validator: CrossValidator, *, seed: int) -> SolverDisagreement:
    """The gap of a hypothesis to motions of the same world by fixed time steps.

    Args:
        state: The hypothesis.
        validator: Of all windows.
        seed: Of the noise.
    """
    w, world, n_threads = state.evidence.windows, state.hypothesis.world(), validator.n_threads
    settings = validator.settings.likelihood
    own = w.predicted(world, n_threads=n_threads)
    other = world.roll_out(
        w.at_q,
        w.at_v,
        n_steps=w.steps,
        dt=w.dt,
        substeps=settings.engine.fixed_substeps,
        impact_parts=1,
        tolerance=settings.simulation.tolerance,
        n_threads=n_threads,
    )[:, 1:]
    touching = np.flatnonzero(~(w.free | w.steady))
    last = w.steps[touching] - 1
    apart = difference(other[touching, last], own[touching, last])
    apart = apart[np.isfinite(apart).all(axis=1)]
    distance, angle = np.linalg.norm(apart[:, :3], axis=1), np.linalg.norm(apart[:, 3:6], axis=1)
    gap = left_of(other, state, validator, seed=seed)
    if not len(apart):
        return SolverDisagreement(gap, 0.0, 0.0)
    far = float(1e3 * np.quantile(distance, 0.95)), float(np.rad2deg(np.quantile(angle, 0.95)))
    return SolverDisagreement(gap, *far)
