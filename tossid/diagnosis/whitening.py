"""First states that suit the windows, and misses whitened by how uncertain they are: variable projection, window by
window (see `windows`)."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

import numpy as np
from numpy.typing import NDArray
from scipy.linalg.lapack import dtrtri

from tossid.diagnosis.engines import Difference
from tossid.diagnosis.windows import SAME, Windows, difference, moved_pose
from tossid.errors import SolverError
from tossid.physics.effects import World

Array = NDArray[np.float64]

BAD = 3.0
"""Standard deviations of chi-squared by which a window's cost may exceed its mean."""
RESTART_STEPS, AFRESH_STEPS = 4, 6
SETTLED = 0.02
"""By how much a window's cost falls at least in a step, for another one."""
MOST_DAMPED = 1e3
_MOST = (0.01, 0.1, 1.0, 10.0)
"""By how much a first state moves in a step: position [m], rotation and joints [rad], and their velocities."""
_STEPS = (2e-4, 2e-3, 5e-3, 3e-2)
"""Of differences, likewise."""


@dataclass(frozen=True)
class Whitening:
    """Inverse Cholesky factors (W, K L, K L) of the misses' covariance, and the misses' mean (W, K L) at a right model.

    volume (W,): log determinant of the factors, which densities of different whitenings need to be compared.
    by_state (W, K L, 2 K): the predictions' derivatives by the first states, taken where misses were `at` (W, K L).
    other (W, K L): the other engine's difference.
    """

    root: Array
    mean: Array
    volume: Array
    by_state: Array
    at: Array
    other: Array

    def __call__(self, misses: Array) -> Array:
        """(W, L, K) -> whitened (W, L, K)."""
        flat = misses.reshape(len(misses), -1) - self.mean
        return (self.root @ flat[..., None])[..., 0].reshape(misses.shape)

    def rows(self, index: NDArray[np.int64]) -> Whitening:
        """Those of some windows."""
        return Whitening(*(getattr(self, field.name)[index] for field in fields(self)))


def linearise(
    windows: Windows,
    world: World,
    *,
    refine: int = 2,
    restarts: int = 0,
    near: Whitening | None = None,
    anew: bool = True,
    engines: Difference | None = None,
    n_threads: int = 1,
) -> tuple[Windows, Whitening]:
    """First states as the windows' own frames tell them under this world, and the whitening there.

    Args:
        refine: steps of Gauss and Newton, damped as Marquardt does, of the first states.
        restarts: how often windows that fit badly are begun anew, from the recorded states and from states near by:
            where contact opens or closes, the first state has several minima.
        near: the whitening of a world and states near by. Its derivatives spare those before the last; and those too
            in windows whose predictions are still the same.
        anew: whether the last are taken; if not, the whitening has the derivatives of `near`.
        engines: how another engine's predictions of the same rigid contact differ; how many times that is in the
            misses is a nuisance of standard deviation 1.
    """
    (W, L), K = windows.inside.shape, windows.channels
    other, center = (np.zeros((W, L, K)), 0.0) if engines is None else (engines.values, engines.expected)
    other = other.reshape(W, K * L)
    kept, cost, miss, at, S = _estimated(windows, world, (other, center), refine, near, n_threads)
    n = K * windows.inside.sum(1)
    rng = np.random.default_rng(0)
    fresh = np.full(W, near is None)
    led = not np.array_equal(windows.at_v, windows.v)
    for turn in range(restarts):
        bad = np.flatnonzero(cost > n + BAD * np.sqrt(2 * n))
        if not len(bad):
            break
        some = kept.rows(bad)
        # once from what was recorded, if another hypothesis has led to where they are; then from near by
        afresh = led and turn == 0
        at_q, at_v = (some.q, some.v) if afresh else _moved(some.at_q, some.at_v, _near(some, S[bad], rng))
        begun, steps = replace(some, at_q=at_q, at_v=at_v), AFRESH_STEPS if afresh else RESTART_STEPS
        tried, new, *found = _estimated(begun, world, (other[bad], center), steps, None, n_threads)
        better = new < cost[bad]
        index, cost = bad[better], _with(cost, bad[better], new[better])
        kept = _with_states(kept, index, tried.at_q[better], tried.at_v[better])
        miss, at, S = (_with(old, index, each[better]) for old, each in zip((miss, at, S), found, strict=True))
        fresh[index] = True
    if near is not None and anew:
        at, S, stale = _followed(kept, world, (miss, at, S), np.arange(W), n_threads)
        fresh[stale] = True
    return kept, _whitening(kept, S, at, other, center, near, fresh)


def _followed(
    windows: Windows, world: World, there: tuple[Array, Array, Array], among: NDArray[np.int64], n_threads: int
) -> tuple[Array, Array, NDArray[np.int64]]:
    """Derivatives taken again in those windows among some whose predictions have moved since they were.

    Args:
        there: misses (W, K L), those where derivatives were taken, and these S (W, K L, 2 K).

    Returns:
        The last two, and which windows have moved.
    """
    miss, at, S = there
    moved = (np.abs(miss[among] - at[among]) / np.sqrt(_variances(windows.rows(among)))).max(1)
    stale = among[moved > SAME]
    if len(stale):
        S = _with(S, stale, _sensitivity(windows.rows(stale), world, miss[stale], n_threads=n_threads))
        at = _with(at, stale, miss[stale])
    return at, S, stale


def _with(values: Array, index: NDArray[np.int64], new: Array) -> Array:
    """A copy with rows replaced."""
    out = values.copy()
    out[index] = new
    return out


def _with_states(windows: Windows, index: NDArray[np.int64], at_q: Array, at_v: Array) -> Windows:
    """The windows, some of them at other states."""
    return replace(windows, at_q=_with(windows.at_q, index, at_q), at_v=_with(windows.at_v, index, at_v))


def _near(at: Windows, S: Array, rng: np.random.Generator) -> Array:
    """(W, 2 K) moves of first states, drawn from twice their posterior's spread."""
    K = at.channels
    columns, _ = _whitened(at, S.reshape(len(S), -1, K, 2 * K), np.zeros((len(S), *at.inside.shape[1:], K)))
    H = columns.mT @ columns
    speeds = np.arange(K, 2 * K)
    H[:, speeds, speeds] += at.prior[:, K:] ** -2.0
    # H = L L^T, so that L^-T z has covariance H^-1
    draw = rng.normal(size=(len(S), 2 * K, 1))
    return 2 * np.linalg.solve(np.linalg.cholesky(H).mT, draw)[..., 0]


def _variances(windows: Windows) -> Array:
    """(W, K L) of the poses; 1 outside."""
    W, L, K = windows.noise.shape
    return np.where(windows.inside[..., None], windows.noise**2, 1.0).reshape(W, K * L)


def _estimated(
    windows: Windows,
    world: World,
    engines: tuple[Array, float],
    refine: int,
    near: Whitening | None,
    n_threads: int,
) -> tuple[Windows, Array, Array, Array, Array]:
    """Windows at refined states, costs (W,): -2 log posterior, but for constants; misses there (W, K L), those where
    derivatives were taken, and these S (W, K L, 2 K). A window whose cost falls no more is left as it is."""
    (W, L), K = windows.inside.shape, windows.channels
    other, center = engines

    def examined(at: Windows, rows: NDArray[np.int64]) -> tuple[Array, Array]:
        miss = at.misses(at.predicted(world, n_threads=n_threads)).reshape(len(rows), K * L)
        return miss, _cost(at, (miss - center * other[rows]).reshape(-1, L, K), other[rows].reshape(-1, L, K))

    kept, damping, rows = windows, np.zeros(W), np.arange(W)
    miss, cost = examined(kept, rows)
    taken = miss if near is None else near.at
    S = _sensitivity(kept, world, miss, n_threads=n_threads) if near is None else near.by_state
    for _ in range(refine):
        some = kept.rows(rows)
        off = (miss[rows] - center * other[rows]).reshape(-1, L, K)
        trial = _refined(some, off, S[rows], other[rows].reshape(-1, L, K), damping[rows])
        trial_miss, trial_cost = examined(trial, rows)
        better = trial_cost < cost[rows]
        falls = cost[rows] - trial_cost > SETTLED
        damping[rows] = np.where(better, damping[rows] / 10, np.maximum(10 * damping[rows], 1.0))
        index = rows[better]
        kept = _with_states(kept, index, trial.at_q[better], trial.at_v[better])
        miss, cost = _with(miss, index, trial_miss[better]), _with(cost, index, trial_cost[better])
        if near is None:
            taken, S, _ = _followed(kept, world, (miss, taken, S), index, n_threads)
        rows = rows[falls | (~better & (damping[rows] < MOST_DAMPED))]
        if not len(rows):
            break
    return kept, cost, miss, taken, S


def _whitened(at: Windows, by_state: Array | None, miss: Array) -> tuple[Array, Array]:
    """What the first state (W, L, K, 2 K) and anything else (W, L, K) put into the first recorded pose and into the
    misses, in standard deviations of the poses' errors: (W, K (L + 1), 2 K) and (W, K (L + 1)).

    Before `miss` comes the recorded first pose less that of linearisation, and before by_state's columns their 1.
    """
    W, K = len(miss), at.channels
    if by_state is None:
        columns = np.zeros((W, 0, 0))
    else:
        first = np.broadcast_to(np.eye(K, 2 * K), (W, 1, K, 2 * K))
        stacked = np.concatenate([first, by_state], axis=1).transpose(0, 2, 1, 3)
        columns = (at.root @ stacked).reshape(W, -1, 2 * K)
    whole = np.concatenate([_off(at)[:, None, :K], miss], axis=1).transpose(0, 2, 1)
    return columns, (at.root @ whole[..., None]).reshape(W, -1)


def _other(at: Windows, other: Array) -> Array:
    """(W, K (L + 1)) the other engine's difference (W, L, K), whitened as misses are."""
    whole = np.concatenate([np.zeros_like(other[:, :1]), other], axis=1).transpose(0, 2, 1)
    out: Array = (at.root @ whole[..., None]).reshape(len(other), -1)
    return out


def _cost(at: Windows, miss: Array, other: Array) -> Array:
    """(W,) -2 log posterior of first states, but for constants, with the best share of the other engine."""
    _, r = _whitened(at, None, miss)
    o = _other(at, other)
    along = (o * r).sum(1) ** 2 / (1 + (o**2).sum(1))
    out: Array = np.minimum(r**2, 1e6).sum(1) - np.minimum(along, 1e6)
    return out + (_off(at)[:, at.channels :] ** 2 / at.prior[:, at.channels :] ** 2).sum(1)


def _refined(at: Windows, miss: Array, S: Array, other: Array, damping: Array) -> Windows:
    """States moved toward their posterior mean, by information: 2 K numbers a window, and the other engine's share.

    damping (W,): Marquardt's.
    """
    K = at.channels
    columns, r = _whitened(at, S.reshape(len(S), -1, K, 2 * K), miss)
    columns = np.concatenate([columns, _other(at, other)[..., None]], axis=2)
    H, g = columns.mT @ columns, (columns.mT @ r[..., None])[..., 0]
    index, most = np.arange(2 * K + 1), _of_state(_MOST, K)
    H[:, index[K:-1], index[K:-1]] += at.prior[:, K:] ** -2.0
    H[:, -1, -1] += 1.0
    g[:, K:-1] += _off(at)[:, K:] / at.prior[:, K:] ** 2
    H[:, index, index] *= 1 + damping[:, None]
    delta = np.linalg.solve(H, g[..., None])[:, :-1, 0]
    at_q, at_v = _moved(at.at_q, at.at_v, np.clip(delta, -most, most))
    return replace(at, at_q=at_q, at_v=at_v)


def _whitening(
    windows: Windows,
    S: Array,
    at: Array,
    other: Array,
    center: float,
    near: Whitening | None,
    fresh: NDArray[np.bool_],
) -> Whitening:
    """Whitening of windows; `near` has the factors where no derivatives are fresh and the other engine is as it was."""
    K = windows.channels
    mean = (S @ _off(windows)[..., None])[..., 0] + center * other
    mean[~np.repeat(windows.inside, K, axis=1)] = 0.0
    new = np.arange(len(S)) if near is None else np.flatnonzero(fresh | (other != near.other).any(1))
    some, by_pose = windows.rows(new), S[new, :, :K]
    (W, L), slow = some.inside.shape, some.slow
    # the first pose's own error (its noise and slow part), its speeds, and the other engine
    first = np.sqrt(some.prior[:, :K] ** 2 + slow[:, :, 0, 0])
    speeds = S[new, :, K:] * some.prior[:, None, K:]
    SP = np.concatenate([by_pose * first[:, None], speeds, other[new, :, None]], axis=2)
    cov = SP @ SP.mT
    index = np.arange(cov.shape[1])
    cov[:, index, index] += _variances(some)
    if slow.any():
        # rows' slow errors are those of the first pose, as far as they are alike
        shared = (by_pose[:, :, None, :] * slow[:, :, 0, 1:].transpose(0, 2, 1)[:, None]).reshape(W, K * L, K * L)
        cov -= shared + shared.mT
        blocks = cov.reshape(W, L, K, L, K)
        for c in range(K):
            blocks[:, :, c, :, c] += slow[:, c, 1:, 1:]
    if near is not None and not len(new):
        root = near.root
    else:
        root = np.zeros((len(S), *cov.shape[1:])) if near is None else near.root.copy()
    for k, factor in zip(new, np.linalg.cholesky(cov), strict=True):
        root[k] = _inverse_lower(factor)
    return Whitening(root, mean, np.log(np.einsum("wii->wi", root)).sum(1), S, at, other)


def _inverse_lower(factor: Array) -> Array:
    """Inverse of a lower triangular matrix; LAPACK's own is six times as fast as a general one."""
    inverse, status = dtrtri(factor, lower=1)
    if status:
        raise SolverError("a window's covariance is singular", total=1)
    return np.asarray(inverse)


def _sensitivity(windows: Windows, world: World, miss: Array, *, n_threads: int) -> Array:
    """S (W, K L, 2 K) at the states of linearisation, where misses are (W, K L)."""
    (W, L), K = windows.inside.shape, windows.channels
    steps = _of_state(_STEPS, K)
    # moved along x or y, predictions move as far, wherever that changes nothing else
    given = 2 if world.same_everywhere else 0
    q, v = [], []
    for j in range(given, 2 * K):
        delta = np.zeros((W, 2 * K))
        delta[:, j] = steps[j]
        moved_q, moved_v = _moved(windows.at_q, windows.at_v, delta)
        q.append(moved_q)
        v.append(moved_v)
    run = windows.predicted(world, np.concatenate(q), np.concatenate(v), n_threads=n_threads)
    S = np.zeros((W, K * L, 2 * K))
    for j in range(given):
        S[:, j::K, j] = windows.inside
    moved = windows.misses(run).reshape(len(q), W, K * L)
    S[..., given:] = np.moveaxis((miss - moved) / steps[given:, None, None], 0, -1)
    return S


def _off(at: Windows) -> Array:
    """Recorded first states less those of linearisation (W, 2 K)."""
    return np.concatenate([difference(at.q, at.at_q), at.v - at.at_v], axis=1)


def _moved(q: Array, v: Array, delta: Array) -> tuple[Array, Array]:
    K = v.shape[1]
    return moved_pose(q, delta[:, :K]), v + delta[:, K:]


def _of_state(sizes: tuple[float, float, float, float], K: int) -> Array:
    """(2 K,) of positions, rotations and joints, and their velocities."""
    place, turn, speed, spin = sizes
    return np.array([place] * 3 + [turn] * (K - 3) + [speed] * 3 + [spin] * (K - 3))
