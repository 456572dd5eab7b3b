"""What exact solvers of the same rigid body disagree on: a gap of that size is no evidence against a simulator.

Where several corners hit or slide at once, rigid bodies with Coulomb friction have no unique motion. Impacts may be
resolved one after another, each where it happens, as tossid's simulator does, or all that fall into a time step at once
(Stewart and Trinkle 1996). Both solve the same contact problem exactly. Here the second makes the motions, they are
measured with noise, and the hypothesis is judged on them like on tosses.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from tossid.diagnosis.inference.evidence import Evidence, collect
from tossid.diagnosis.likelihood.states import difference, moved_pose
from tossid.diagnosis.likelihood.windows import Windows
from tossid.diagnosis.parts import Part

Array = NDArray[np.float64]

FIXED_SUBSTEPS = 16
"""Steps a frame of the other exact solver, in which impacts of a step are resolved at once."""


@dataclass(frozen=True)
class SolverDisagreement(Part):
    """The gap that another exact solver of the same rigid body shows.

    Attributes:
        gap: Root mean square of whitened residuals of its motions.
        position_mm: Distance of both solvers' motions at the end of a window in contact, 95 % quantile [mm].
        rotation_deg: Angle, likewise [deg].
    """

    gap: float
    position_mm: float
    rotation_deg: float


def solver_disagreement(evidence: Evidence, *, seed: int) -> SolverDisagreement:
    """The gap of a hypothesis to motions of the same world by fixed time steps.

    Args:
        evidence: Of the hypothesis.
        seed: Of the noise.
    """
    w, world, n_threads = evidence.windows, evidence.hypothesis.world(), evidence.n_threads
    own = w.predicted(world, n_threads=n_threads)
    other = world.roll_out(
        w.at_q,
        w.at_v,
        n_steps=w.steps,
        dt=w.dt,
        substeps=FIXED_SUBSTEPS,
        impact_parts=1,
        tolerance=w.settings.simulation.tolerance,
        n_threads=n_threads,
    )[:, 1:]
    gap = left_of(other, evidence, seed=seed)
    touching = np.flatnonzero(~(w.free | w.steady))
    last = w.steps[touching] - 1
    apart = difference(other[touching, last], own[touching, last])
    apart = apart[np.isfinite(apart).all(axis=1)]
    if not len(apart):
        return SolverDisagreement(gap, 0.0, 0.0)
    distance, angle = (float(np.quantile(np.linalg.norm(each, axis=1), 0.95)) for each in (apart[:, :3], apart[:, 3:6]))
    return SolverDisagreement(gap, 1e3 * distance, float(np.rad2deg(angle)))


def left_of(truth: Array, evidence: Evidence, *, seed: int) -> float:
    """Root mean square of whitened residuals that a hypothesis leaves of given motions, measured with noise.

    The motions go through the same steps as recorded ones. Of the hypothesis's own motions noise alone would be left,
    were these steps exact.

    Args:
        truth: (W, F, K + 1) motions in the windows, from the hypothesis's first states.
        evidence: Of the hypothesis.
        seed: Of the noise.
    """
    w, rng = evidence.windows, np.random.default_rng(seed + 1)
    truth = np.where(np.isfinite(truth), truth, w.y[:, : truth.shape[1]])
    before, slow = _slow_errors(w, truth.shape[1], rng)
    y = moved_pose(truth, w.y_noise[:, : truth.shape[1]] * rng.normal(size=slow.shape) + slow)
    # recorded velocities are as wrong as they were
    q = moved_pose(w.at_q, w.prior[:, : w.channels] * rng.normal(size=before.shape) + before)
    made = collect(replace(w, y=y, q=q), evidence.hypothesis, n_threads=evidence.n_threads)
    largest = evidence.density.largest_residual**2
    return float(np.sqrt(np.minimum(made.residuals[w.counted] ** 2, largest).mean()))


def _slow_errors(w: Windows, frames: int, rng: np.random.Generator) -> tuple[Array, Array]:
    """A tracker's slow errors (`Windows.slow`): of first poses (W, K) and of frames (W, frames, K)."""
    (W, L), K = w.inside.shape, w.channels
    drawn = np.zeros((W, L + 1, K))
    if w.slow.any():
        index = np.arange(L + 1)
        cov = w.slow.copy()
        cov[..., index, index] += 1e-9 * cov[..., :1, 0] + 1e-30  # they may be the same in all frames
        drawn = (np.linalg.cholesky(cov) @ rng.normal(size=(W, K, L + 1, 1)))[..., 0].transpose(0, 2, 1)
    row = 1 + w.mix[..., :frames].argmax(axis=1)
    return drawn[:, 0], np.take_along_axis(drawn, row[..., None], axis=1)
