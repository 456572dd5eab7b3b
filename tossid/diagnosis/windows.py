"""Short predictions from states that are known as well as they were measured, and their whitened misses.

A toss is cut into windows. In each, the simulator f starts from a state x that is a nuisance: its pose is known as
well as poses are measured, its velocity hardly at all (recorded velocities lag, and are smeared over impacts). With
S = df/dx and poses y with noise R, to first order around x_0,

    y - f(x_0) - S (x_rec - x_0) ~ N(0, R + S P S^T),

P the covariance of the recorded state x_rec. Whitened by the Cholesky factor in the order of time, every entry is
the innovation of one frame and channel given the frames before it: of unit variance where the simulator is right,
whatever the first state was.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg.lapack import dtrtri

from tossid.errors import SolverError
from tossid.physics.effects import World
from tossid.rotations import quat_boxminus, quat_exp, quat_mul, quat_normalize
from tossid.types import Toss

Array = NDArray[np.float64]

LENGTH = 20
"""Frames of a window."""
SUBSTEPS = 4
"""Simulator steps a frame."""
SPEED_PRIOR, SPIN_PRIOR = 0.5, 5.0
"""Standard deviations [m/s], [rad/s] of recorded velocities, as far as windows trust them."""
LOST = 3.0
"""Miss [m, rad] that counts for a frame whose simulation diverged."""
_STEPS = np.array([2e-4] * 3 + [2e-3] * 3 + [5e-3] * 3 + [3e-2] * 3)


@dataclass(frozen=True)
class Windows:
    """W windows of at most L frames after their first, of tosses of a single body.

    q (W, 7), v (W, 6): recorded first states. at_q, at_v: states around which predictions are linearised.
    y (W, L, 7): measured poses; noise (W, L, 6): their standard deviations [m, rad]; inside (W, L).
    toss (W,), frame (W,): whose, and from where. phase (W, L): of `Phase`. dt [s].
    prior (W, 12): standard deviations of the recorded states.
    """

    q: Array
    v: Array
    at_q: Array
    at_v: Array
    y: Array
    noise: Array
    inside: NDArray[np.bool_]
    toss: NDArray[np.int64]
    frame: NDArray[np.int64]
    phase: NDArray[np.uint8]
    dt: float
    prior: Array

    @property
    def n_tosses(self) -> int:
        return int(self.toss.max()) + 1

    def predicted(self, world: World, q: Array | None = None, v: Array | None = None, *, n_threads: int = 1) -> Array:
        """(W, L, 7) recorded poses as the world predicts them from (q, v), or from the states of linearisation."""
        n = self.inside.sum(1)
        q, v = (self.at_q if q is None else q), (self.at_v if v is None else v)
        times = len(q) // len(n)
        run = world.roll_out(q, v, n_steps=np.tile(n, times), dt=self.dt, substeps=SUBSTEPS, n_threads=n_threads)
        return run[:, 1 : self.y.shape[1] + 1]

    def misses(self, predicted: Array) -> Array:
        """(·, L, 6) measured less predicted: position [m], rotation vector in the body's frame [rad]; 0 outside."""
        times = len(predicted) // len(self.y)
        y, inside = np.tile(self.y, (times, 1, 1)), np.tile(self.inside, (times, 1))
        out = np.concatenate([y[..., :3] - predicted[..., :3], quat_boxminus(y[..., 3:7], predicted[..., 3:7])], -1)
        out = np.clip(np.where(np.isfinite(out), out, LOST), -LOST, LOST)
        out[~inside] = 0.0
        return out

    def rows(self, index: NDArray[np.int64]) -> Windows:
        """The windows of the given rows."""
        names = ("q", "v", "at_q", "at_v", "y", "noise", "inside", "toss", "frame", "phase", "prior")
        return replace(self, **{name: getattr(self, name)[index] for name in names})


def make_windows(tosses: Sequence[Toss], *, length: int = LENGTH) -> Windows:
    """Cut tosses into windows that follow one another; what is left at a toss's end is kept if half a window long."""
    parts: dict[str, list[Any]] = {name: [] for name in ("q", "v", "y", "noise", "inside", "toss", "frame", "phase")}
    for i, toss in enumerate(tosses):
        std = np.sqrt(np.maximum(np.einsum("nii->ni", toss.q_cov)[:, :6], 1e-14))
        for first in range(0, len(toss) - 1, length):
            n = min(length, len(toss) - 1 - first)
            if n < length // 2:
                break
            rows = np.minimum(np.arange(first + 1, first + length + 1), first + n)
            parts["q"].append(toss.q[first])
            parts["v"].append(toss.v[first])
            parts["y"].append(toss.q[rows])
            parts["noise"].append(std[rows])
            parts["inside"].append(np.arange(length) < n)
            parts["phase"].append(toss.phase[rows])
            parts["toss"].append(np.int64(i))
            parts["frame"].append(np.int64(first))
    done: dict[str, Any] = {name: np.array(values) for name, values in parts.items()}
    dt = float(np.median(np.concatenate([np.diff(toss.t) for toss in tosses])))
    covs = np.stack([tosses[i].q_cov[k] for i, k in zip(done["toss"], done["frame"], strict=True)])
    first_noise = np.sqrt(np.maximum(np.einsum("nii->ni", covs)[:, :6], 1e-14))
    speeds = np.array([SPEED_PRIOR] * 3 + [SPIN_PRIOR] * 3)
    prior = np.concatenate([first_noise, np.tile(speeds, (len(first_noise), 1))], axis=1)
    return Windows(at_q=done["q"].copy(), at_v=done["v"].copy(), dt=dt, prior=prior, **done)


@dataclass(frozen=True)
class Whitening:
    """Inverse Cholesky factors (W, 6 L, 6 L) of the misses' covariance, and the misses' mean (W, 6 L) at a right model.

    volume (W,): log determinant of the factors, which densities of different whitenings need to be compared.
    """

    root: Array
    mean: Array
    volume: Array

    def __call__(self, misses: Array) -> Array:
        """(W, L, 6) -> whitened (W, L, 6)."""
        W, L, _ = misses.shape
        flat = misses.reshape(W, -1) - self.mean
        return (self.root @ flat[..., None])[..., 0].reshape(W, L, 6)


def linearise(windows: Windows, world: World, *, refine: int = 2, n_threads: int = 1) -> tuple[Windows, Whitening]:
    """First states as the windows' own frames tell them under this world, and the whitening there.

    Args:
        refine: Gauss-Newton steps of the first states.
    """
    W, L = windows.inside.shape
    R = (windows.noise**2).reshape(W, 6 * L)
    R = np.where(np.repeat(windows.inside, 6, axis=1), R, 1.0)
    P = windows.prior**2
    best = np.full(W, np.inf)
    kept = windows
    trial = windows
    for step in range(refine + 1):
        miss, S = _sensitivity(trial, world, n_threads=n_threads)
        away = _difference(windows, trial)
        cost = (np.minimum(miss**2 / R, 1e6)).sum(1) + (away**2 / P).sum(1)
        better = cost < best
        if step == 0:
            kept_miss, kept_S, best = miss, S, cost
        else:
            best = np.where(better, cost, best)
            at_q, at_v = kept.at_q.copy(), kept.at_v.copy()
            at_q[better], at_v[better] = trial.at_q[better], trial.at_v[better]
            kept = replace(kept, at_q=at_q, at_v=at_v)
            kept_miss, kept_S = kept_miss.copy(), kept_S.copy()
            kept_miss[better], kept_S[better] = miss[better], S[better]
        if step == refine:
            break
        # posterior mean of the state, by information: 12 numbers a window
        away = _difference(windows, kept)
        SR = kept_S / R[..., None]
        H = kept_S.mT @ SR + np.eye(12) / P[:, None, :]
        g = (SR.mT @ kept_miss[..., None])[..., 0] + away / P
        delta = np.linalg.solve(H, g[..., None])[..., 0]
        limit = np.array([0.01] * 3 + [0.1] * 3 + [1.0] * 3 + [10.0] * 3)
        delta = np.clip(delta, -limit, limit)
        at_q, at_v = _moved(kept.at_q, kept.at_v, delta)
        trial = replace(kept, at_q=at_q, at_v=at_v)
    away = _difference(windows, kept)
    mean = (kept_S @ away[..., None])[..., 0]
    SP = kept_S * windows.prior[:, None, :]
    cov = SP @ SP.mT
    index = np.arange(6 * L)
    cov[:, index, index] += R
    root = np.stack([_inverse_lower(factor) for factor in np.linalg.cholesky(cov)])
    outside = ~np.repeat(windows.inside, 6, axis=1)
    mean[outside] = 0.0
    volume = np.log(np.einsum("wii->wi", root)).sum(1)
    return kept, Whitening(root, mean, volume)


def _inverse_lower(factor: Array) -> Array:
    """Inverse of a lower triangular matrix; LAPACK's own is six times as fast as a general one."""
    inverse, status = dtrtri(factor, lower=1)
    if status:
        raise SolverError("a window's covariance is singular", total=1)
    return np.asarray(inverse)


def _sensitivity(windows: Windows, world: World, *, n_threads: int) -> tuple[Array, Array]:
    """Misses (W, 6 L) at the states of linearisation, and S (W, 6 L, 12)."""
    W, L = windows.inside.shape
    q, v = [windows.at_q], [windows.at_v]
    for j in range(12):
        delta = np.zeros((W, 12))
        delta[:, j] = _STEPS[j]
        moved_q, moved_v = _moved(windows.at_q, windows.at_v, delta)
        q.append(moved_q)
        v.append(moved_v)
    run = windows.predicted(world, np.concatenate(q), np.concatenate(v), n_threads=n_threads)
    miss = windows.misses(run).reshape(13, W, 6 * L)
    S = (miss[0] - miss[1:]) / _STEPS[:, None, None]
    return miss[0], np.moveaxis(S, 0, -1)


def _difference(windows: Windows, at: Windows) -> Array:
    """Recorded first states less those of linearisation (W, 12)."""
    turned = quat_boxminus(windows.q[:, 3:7], at.at_q[:, 3:7])
    return np.concatenate([windows.q[:, :3] - at.at_q[:, :3], turned, windows.v - at.at_v], axis=1)


def _moved(q: Array, v: Array, delta: Array) -> tuple[Array, Array]:
    turned = quat_normalize(quat_mul(q[:, 3:7], quat_exp(delta[:, 3:6])))
    return np.concatenate([q[:, :3] + delta[:, :3], turned], axis=1), v + delta[:, 6:]
