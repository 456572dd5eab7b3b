"""What the likelihood itself leaves of the motions of the world that was found: the misspecification of the diagnosis.

The world's own motions, from the windows' first states and measured with noise, go through the same steps as recorded
ones. Were all of these steps exact, noise alone would be left. What is left beyond it, or is missing, belongs to the
diagnosis: first states that contact makes ambiguous, derivatives that hold in no neighbourhood, noise that is not as
stated. No verdict rests on it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tossid.diagnosis.likelihood.evidence import Evidence
from tossid.diagnosis.likelihood.states import moved_pose
from tossid.diagnosis.likelihood.whitening import linearise
from tossid.diagnosis.likelihood.windows import Windows
from tossid.diagnosis.localisation.noise import Floor
from tossid.diagnosis.selection.cross_validation import Candidate, CrossValidator

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Misspecification:
    """How far the simulated floor is from the noise floor.

    Attributes:
        simulated_floor: Root mean square of whitened residuals of the found world's own motions.
        adds: The same minus the noise floor.
    """

    simulated_floor: float
    adds: float

    def as_json(self) -> dict[str, Any]:
        """gap.json's "misspecification"."""
        return {"simulated_floor": self.simulated_floor, "adds": self.adds}


def misspecification(state: Candidate, validator: CrossValidator, floor: Floor, *, seed: int) -> Misspecification:
    """What is left of motions that a hypothesis's world itself makes, beyond the noise floor.

    Args:
        state: The hypothesis.
        validator: Of all windows.
        floor: The noise floor.
        seed: Of the noise.
    """
    truth = state.evidence.windows.predicted(state.hypothesis.world(), n_threads=validator.n_threads)
    rms = left_of(truth, state, validator, seed=seed)
    return Misspecification(rms, rms - floor.rms)


def left_of(truth: Array, state: Candidate, validator: CrossValidator, *, seed: int) -> float:
    """Root mean square of whitened residuals that a hypothesis leaves of given motions, measured with noise.

    Args:
        truth: (W, F, K + 1) motions in the windows, from the hypothesis's first states.
        state: The hypothesis.
        validator: Of all windows.
        seed: Of the noise.
    """
    e, world = state.evidence, state.hypothesis.world()
    w = e.windows
    rng = np.random.default_rng(seed + 1)
    truth = np.where(np.isfinite(truth), truth, w.y[:, : truth.shape[1]])
    before, slow = _slow_errors(w, truth.shape[1], rng)
    noise = w.y_noise[:, : truth.shape[1]] * rng.normal(size=slow.shape) + slow
    y = moved_pose(truth, noise)
    first = w.prior[:, : w.channels] * rng.normal(size=before.shape) + before
    q, v = moved_pose(w.at_q, first), w.v  # velocities are as wrong as the recorded ones
    made = replace(w, y=y, q=q, v=v, at_q=q, at_v=v)
    # windows may contain a multiple of the engines' difference; here it is none
    difference = None if e.difference is None else replace(e.difference, expected=0.0)
    restarts = validator.settings.cross_validation.restarts
    kept, whitening = linearise(
        made, world, refine=6, restarts=restarts, difference=difference, n_threads=validator.n_threads
    )
    r = Evidence(kept, whitening, validator.n_threads).residuals(world)
    largest = e.density.largest_residual**2
    return float(np.sqrt(np.minimum(r[w.counted] ** 2, largest).mean()))


def _slow_errors(w: Windows, frames: int, rng: np.random.Generator) -> tuple[Array, Array]:
    """A tracker's slow errors (`Windows.slow`): of first poses (W, K) and of frames (W, frames, K)."""
    (W, L), K = w.inside.shape, w.channels
    drawn = np.zeros((W, L + 1, K))
    if w.slow.any():
        cov = w.slow.copy()
        index = np.arange(L + 1)
        cov[..., index, index] += 1e-9 * cov[..., :1, 0] + 1e-30
        drawn = (np.linalg.cholesky(cov) @ rng.normal(size=(W, K, L + 1, 1)))[..., 0].transpose(0, 2, 1)
    row = 1 + w.mix[..., :frames].argmax(axis=1)
    return drawn[:, 0], np.take_along_axis(drawn, row[..., None], axis=1)
