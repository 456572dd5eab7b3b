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

import itertools
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
UNEVEN = 0.3
"""Share by which a time step may differ from the median one."""
BAD = 3.0
"""Standard deviations of chi-squared by which a window's cost may exceed its mean."""
RESTART_STEPS = 4
_MOST = np.array([0.01] * 3 + [0.1] * 3 + [1.0] * 3 + [10.0] * 3)
"""By how much a first state moves in a step."""
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
    """Cut tosses into windows that follow one another, and end where frames are missing; what is left at the end of
    a stretch is kept if half a window long."""
    dt = float(np.median(np.concatenate([np.diff(toss.t) for toss in tosses])))
    parts: dict[str, list[Any]] = {
        name: [] for name in ("q", "v", "y", "noise", "inside", "toss", "frame", "phase", "first")
    }
    for i, toss in enumerate(tosses):
        measured, cov = toss.measured
        std = np.sqrt(np.maximum(np.einsum("nii->ni", cov)[:, :6], 1e-14))
        missing = np.abs(np.diff(toss.t) / dt - 1) > UNEVEN
        for first, n in _stretches(missing, length):
            rows = np.minimum(np.arange(first + 1, first + length + 1), first + n)
            parts["q"].append(measured[first])
            parts["v"].append(toss.v[first])
            parts["y"].append(measured[rows])
            parts["noise"].append(std[rows])
            parts["inside"].append(np.arange(length) < n)
            parts["phase"].append(toss.phase[rows])
            parts["toss"].append(np.int64(i))
            parts["frame"].append(np.int64(first))
            parts["first"].append(std[first])
    done: dict[str, Any] = {name: np.array(values) for name, values in parts.items()}
    first_noise = done.pop("first")
    speeds = np.array([SPEED_PRIOR] * 3 + [SPIN_PRIOR] * 3)
    prior = np.concatenate([first_noise, np.tile(speeds, (len(first_noise), 1))], axis=1)
    return Windows(at_q=done["q"].copy(), at_v=done["v"].copy(), dt=dt, prior=prior, **done)


def _stretches(missing: NDArray[np.bool_], length: int) -> list[tuple[int, int]]:
    """First frames and numbers of further frames of a toss's windows. missing (n - 1,): steps that are none."""
    edges = [-1, *np.flatnonzero(missing).tolist(), len(missing)]
    out = []
    for begin, end in itertools.pairwise(edges):
        for first in range(begin + 1, end, length):
            n = min(length, end - first)
            if n >= length // 2:
                out.append((first, n))
    return out


@dataclass(frozen=True)
class Whitening:
    """Inverse Cholesky factors (W, 6 L, 6 L) of the misses' covariance, and the misses' mean (W, 6 L) at a right model.

    volume (W,): log determinant of the factors, which densities of different whitenings need to be compared.
    by_state (W, 6 L, 12): the predictions' derivatives by the first states there.
    """

    root: Array
    mean: Array
    volume: Array
    by_state: Array

    def __call__(self, misses: Array) -> Array:
        """(W, L, 6) -> whitened (W, L, 6)."""
        W, L, _ = misses.shape
        flat = misses.reshape(W, -1) - self.mean
        return (self.root @ flat[..., None])[..., 0].reshape(W, L, 6)

    def rows(self, index: NDArray[np.int64]) -> Whitening:
        """Those of some windows."""
        return Whitening(self.root[index], self.mean[index], self.volume[index], self.by_state[index])


def linearise(
    windows: Windows,
    world: World,
    *,
    refine: int = 2,
    restarts: int = 0,
    by_state: Array | None = None,
    engines: tuple[Array, float] | None = None,
    n_threads: int = 1,
) -> tuple[Windows, Whitening]:
    """First states as the windows' own frames tell them under this world, and the whitening there.

    Args:
        refine: steps of Gauss and Newton, damped as Marquardt does, of the first states.
        restarts: how often windows that fit badly are begun anew from states near by: where contact opens or closes,
            the first state has several minima.
        by_state: (W, 6 L, 12) derivatives near here, which spare those before the last.
        engines: how another engine's predictions of the same rigid contact differ (W, L, 6), and how many times
            that is expected in the misses: the number is a nuisance of standard deviation 1.
    """
    W, L = windows.inside.shape
    none = np.zeros((W, L, 6)), 0.0
    other, center = engines or none
    kept, S, cost = _estimated(windows, world, (other, center), refine, by_state, n_threads)
    n = 6 * windows.inside.sum(1)
    rng = np.random.default_rng(0)
    for _ in range(restarts):
        bad = np.flatnonzero(cost > n + BAD * np.sqrt(2 * n))
        if not len(bad):
            break
        some = kept.rows(bad)
        delta = _near(some, S[bad], rng)
        at_q, at_v = _moved(some.at_q, some.at_v, delta)
        tried, there, now = _estimated(
            replace(some, at_q=at_q, at_v=at_v), world, (other[bad], center), RESTART_STEPS, None, n_threads
        )
        better = now < cost[bad]
        index = bad[better]
        at_q, at_v, S, cost = kept.at_q.copy(), kept.at_v.copy(), S.copy(), cost.copy()
        at_q[index], at_v[index], S[index], cost[index] = (
            tried.at_q[better],
            tried.at_v[better],
            there[better],
            now[better],
        )
        kept = replace(kept, at_q=at_q, at_v=at_v)
    if by_state is not None:
        _, S = _sensitivity(kept, world, n_threads=n_threads)
    return kept, _whitening(kept, S, other.reshape(W, 6 * L), center)


def _near(at: Windows, S: Array, rng: np.random.Generator) -> Array:
    """(W, 12) moves of first states, drawn from twice their posterior's spread."""
    H = S.mT @ (S / _variances(at)[..., None])
    H[:, np.arange(12), np.arange(12)] += at.prior**-2.0
    # H = L L^T, so that L^-T z has covariance H^-1
    draw = rng.normal(size=(len(S), 12, 1))
    return 2 * np.linalg.solve(np.linalg.cholesky(H).mT, draw)[..., 0]


def _variances(windows: Windows) -> Array:
    """(W, 6 L) of the poses; 1 outside."""
    W, L = windows.inside.shape
    return np.where(np.repeat(windows.inside, 6, axis=1), (windows.noise**2).reshape(W, 6 * L), 1.0)


def _estimated(
    windows: Windows, world: World, engines: tuple[Array, float], refine: int, by_state: Array | None, n_threads: int
) -> tuple[Windows, Array, Array]:
    """Windows at refined states, derivatives S (W, 6 L, 12), and costs (W,): -2 log posterior, but for constants."""
    W, L = windows.inside.shape
    R, other, center = _variances(windows), engines[0].reshape(W, 6 * L), engines[1]

    def examined(at: Windows) -> tuple[Array, Array, Array]:
        if by_state is None:
            miss, S = _sensitivity(at, world, n_threads=n_threads)
        else:
            miss, S = at.misses(at.predicted(world, n_threads=n_threads)).reshape(W, 6 * L), by_state
        miss = miss - center * other
        along = (other * miss / R).sum(1) ** 2 / (1 + (other**2 / R).sum(1))
        cost = np.minimum(miss**2 / R, 1e6).sum(1) - np.minimum(along, 1e6)
        return miss, S, cost + (_off(at) ** 2 / at.prior**2).sum(1)

    kept, damping = windows, np.zeros(W)
    miss, S, cost = examined(kept)
    for _ in range(refine):
        trial = _refined(kept, miss, S, R, other, damping)
        trial_miss, trial_S, trial_cost = examined(trial)
        better = trial_cost < cost
        damping = np.where(better, damping / 10, np.maximum(10 * damping, 1.0))
        kept = replace(
            kept,
            at_q=np.where(better[:, None], trial.at_q, kept.at_q),
            at_v=np.where(better[:, None], trial.at_v, kept.at_v),
        )
        miss, cost = np.where(better[:, None], trial_miss, miss), np.where(better, trial_cost, cost)
        S = np.where(better[:, None, None], trial_S, S)
    return kept, S, cost


def _refined(at: Windows, miss: Array, S: Array, R: Array, other: Array, damping: Array) -> Windows:
    """States moved toward their posterior mean, by information: 12 numbers a window, and the other engine's share.

    damping (W,): Marquardt's.
    """
    W = len(S)
    columns = np.concatenate([S, other[..., None]], axis=2)
    weighted = columns / R[..., None]
    H = columns.mT @ weighted
    prior = np.concatenate([at.prior**-2.0, np.ones((W, 1))], axis=1)
    index = np.arange(13)
    H[:, index, index] = (H[:, index, index] + prior) * (1 + damping[:, None])
    g = (weighted.mT @ miss[..., None])[..., 0]
    g[:, :12] += prior[:, :12] * _off(at)
    delta = np.linalg.solve(H, g[..., None])[:, :12, 0]
    at_q, at_v = _moved(at.at_q, at.at_v, np.clip(delta, -_MOST, _MOST))
    return replace(at, at_q=at_q, at_v=at_v)


def _whitening(at: Windows, S: Array, other: Array, center: float) -> Whitening:
    mean = (S @ _off(at)[..., None])[..., 0] + center * other
    SP = np.concatenate([S * at.prior[:, None, :], other[..., None]], axis=2)
    cov = SP @ SP.mT
    index = np.arange(cov.shape[1])
    cov[:, index, index] += _variances(at)
    root = np.stack([_inverse_lower(factor) for factor in np.linalg.cholesky(cov)])
    mean[~np.repeat(at.inside, 6, axis=1)] = 0.0
    return Whitening(root, mean, np.log(np.einsum("wii->wi", root)).sum(1), S)


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


def _off(at: Windows) -> Array:
    """Recorded first states less those of linearisation (W, 12)."""
    turned = quat_boxminus(at.q[:, 3:7], at.at_q[:, 3:7])
    return np.concatenate([at.q[:, :3] - at.at_q[:, :3], turned, at.v - at.at_v], axis=1)


def _moved(q: Array, v: Array, delta: Array) -> tuple[Array, Array]:
    turned = quat_normalize(quat_mul(q[:, 3:7], quat_exp(delta[:, 3:6])))
    return np.concatenate([q[:, :3] + delta[:, :3], turned], axis=1), v + delta[:, 6:]
