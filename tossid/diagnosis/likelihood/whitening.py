"""First states that suit the windows, and residuals whitened by how uncertain these are.

Each window's first state is a nuisance parameter. It is estimated by damped Gauss-Newton steps, window by window, and
its uncertainty becomes part of the residuals' covariance (see `windows`).
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

import numpy as np
from numpy.typing import NDArray
from scipy.linalg.lapack import dtrtri

from tossid.diagnosis.likelihood.engine_discrepancy import EngineDifference
from tossid.diagnosis.likelihood.windows import Windows, difference, moved_pose
from tossid.errors import SolverError
from tossid.least_squares import Damping
from tossid.physics.effects import World

Array = NDArray[np.float64]
Index = NDArray[np.int64]

DAMPING = Damping(grow=10.0, fall=0.1, least=0.1)
"""Marquardt's, of each window's first state."""


@dataclass(frozen=True)
class Whitening:
    """How the residuals of W windows are whitened.

    Attributes:
        root: (W, K L, K L) inverse Cholesky factors of their covariance.
        mean: (W, K L) their mean under a right model.
        log_det: (W,) log determinants of the factors, without which densities of different whitenings do not compare.
        by_state: (W, K L, 2 K) derivatives of the predictions by the first states.
        taken_at: (W, K L) residuals where these derivatives were taken.
        other: (W, K L) the difference to the other engine.
    """

    root: Array
    mean: Array
    log_det: Array
    by_state: Array
    taken_at: Array
    other: Array

    def __call__(self, residuals: Array) -> Array:
        """(W, L, K) whitened residuals.

        Args:
            residuals: (W, L, K) as of `Windows.residuals`.
        """
        flat = residuals.reshape(len(residuals), -1) - self.mean
        return (self.root @ flat[..., None])[..., 0].reshape(residuals.shape)

    def rows(self, index: Index) -> Whitening:
        """The whitening of some windows.

        Args:
            index: (n,) their numbers.
        """
        return Whitening(*(getattr(self, field.name)[index] for field in fields(self)))


@dataclass(frozen=True)
class _Estimate:
    """Windows at estimated first states.

    Attributes:
        windows: There.
        cost: (W,) -2 log posterior, but for constants.
        residuals: (W, K L) there.
        taken_at: (W, K L) residuals where the derivatives were taken.
        by_state: (W, K L, 2 K) these derivatives.
    """

    windows: Windows
    cost: Array
    residuals: Array
    taken_at: Array
    by_state: Array

    def with_rows(self, index: Index, other: _Estimate, better: NDArray[np.bool_]) -> _Estimate:
        """With some rows as they are in another estimate of `len(better)` windows, of which the better ones count."""
        w = other.windows
        new = (w.at_q, w.at_v, other.cost, other.residuals, other.taken_at, other.by_state)
        at_q, at_v, cost, residuals, taken_at, by_state = (each[better] for each in new)
        return _Estimate(
            _with_states(self.windows, index, at_q, at_v),
            _with(self.cost, index, cost),
            _with(self.residuals, index, residuals),
            _with(self.taken_at, index, taken_at),
            _with(self.by_state, index, by_state),
        )


def linearise(
    windows: Windows,
    world: World,
    *,
    refine: int = 2,
    restarts: int = 0,
    near: Whitening | None = None,
    update: bool = True,
    difference: EngineDifference | None = None,
    n_threads: int = 1,
) -> tuple[Windows, Whitening]:
    """The windows at first states that their own frames determine under a world, and the whitening there.

    Args:
        windows: At first states from which to begin.
        world: The simulator.
        refine: Most Gauss-Newton steps of the first states, damped as by Marquardt.
        restarts: How often windows that fit poorly are restarted, from the recorded or from perturbed first states:
            where contact opens or closes, the posterior of a first state has several modes.
        near: The whitening under a world and first states near by. Its derivatives are used in all steps; at the end
            they are computed anew only for windows whose predictions have moved.
        update: Whether they are computed anew at the end.
        difference: To another engine's predictions of the same rigid contact. Its multiple in the residuals is a
            nuisance parameter of standard deviation 1.
        n_threads: Of the simulator.
    """
    (W, L), K = windows.inside.shape, windows.channels
    settings = windows.settings.whitening
    other, center = (np.zeros((W, L, K)), 0.0) if difference is None else (difference.values, difference.expected)
    other = other.reshape(W, K * L)
    best = _estimate(windows, world, (other, center), refine, near, n_threads)
    n = K * windows.inside.sum(1)
    rng = np.random.default_rng(0)
    fresh = np.full(W, near is None)
    moved_before = not np.array_equal(windows.at_v, windows.v)
    for turn in range(restarts):
        poor = np.flatnonzero(best.cost > n + settings.poor_fit * np.sqrt(2 * n))
        if not len(poor):
            break
        some = best.windows.rows(poor)
        # the recorded first state is tried once, if another hypothesis has moved the first states away from it
        recorded = moved_before and turn == 0
        if recorded:
            at_q, at_v, steps = some.q, some.v, settings.recorded_restart_steps
        else:
            at_q, at_v = _moved(some.at_q, some.at_v, _perturbations(some, best.by_state[poor], rng))
            steps = settings.restart_steps
        begun = replace(some, at_q=at_q, at_v=at_v)
        tried = _estimate(begun, world, (other[poor], center), steps, None, n_threads)
        better = tried.cost < best.cost[poor]
        best = best.with_rows(poor[better], tried, better)
        fresh[poor[better]] = True
    if near is not None and update:
        best, stale = _with_derivatives(best, world, np.arange(W), n_threads)
        fresh[stale] = True
    return best.windows, _whitening(best, other, center, near, fresh)


def _with_derivatives(there: _Estimate, world: World, among: Index, n_threads: int) -> tuple[_Estimate, Index]:
    """Derivatives computed anew in those windows among some whose predictions have moved since they were taken.

    Returns:
        The estimate with them, and which windows these are.
    """
    windows = there.windows
    moved = np.abs(there.residuals[among] - there.taken_at[among]) / np.sqrt(_variances(windows.rows(among)))
    stale = among[moved.max(1) > windows.settings.whitening.reuse_tolerance]
    if len(stale):
        new = _derivatives(windows.rows(stale), world, there.residuals[stale], n_threads=n_threads)
        taken_at = _with(there.taken_at, stale, there.residuals[stale])
        there = replace(there, by_state=_with(there.by_state, stale, new), taken_at=taken_at)
    return there, stale


def _with(values: Array, index: Index, new: Array) -> Array:
    """A copy with rows replaced."""
    out = values.copy()
    out[index] = new
    return out


def _with_states(windows: Windows, index: Index, at_q: Array, at_v: Array) -> Windows:
    """The windows, some of them at other first states."""
    return replace(windows, at_q=_with(windows.at_q, index, at_q), at_v=_with(windows.at_v, index, at_v))


def _perturbations(at: Windows, by_state: Array, rng: np.random.Generator) -> Array:
    """(W, 2 K) changes of first states, drawn from twice their posterior's standard deviation."""
    K = at.channels
    zeros = np.zeros((len(by_state), *at.inside.shape[1:], K))
    columns, _ = _in_noise(at, by_state.reshape(len(by_state), -1, K, 2 * K), zeros)
    H = columns.mT @ columns
    speeds = np.arange(K, 2 * K)
    H[:, speeds, speeds] += at.prior[:, K:] ** -2.0
    # H = L L^T, so that L^-T z has covariance H^-1
    draw = rng.normal(size=(len(by_state), 2 * K, 1))
    return 2 * np.linalg.solve(np.linalg.cholesky(H).mT, draw)[..., 0]


def _variances(windows: Windows) -> Array:
    """(W, K L) of the poses; 1 in rows that do not exist."""
    W, L, K = windows.noise.shape
    return np.where(windows.inside[..., None], windows.noise**2, 1.0).reshape(W, K * L)


def _estimate(
    windows: Windows,
    world: World,
    engine: tuple[Array, float],
    refine: int,
    near: Whitening | None,
    n_threads: int,
) -> _Estimate:
    """Windows at refined first states. A window whose cost falls no more is left as it is.

    engine: the difference to the other engine (W, K L), and how many times it is expected in the residuals.
    """
    (W, L), K = windows.inside.shape, windows.channels
    settings, (other, center) = windows.settings.whitening, engine

    def evaluated(at: Windows, rows: Index) -> tuple[Array, Array]:
        """Residuals and cost of some windows."""
        r = at.residuals(at.predicted(world, n_threads=n_threads)).reshape(len(rows), K * L)
        return r, _cost(at, (r - center * other[rows]).reshape(-1, L, K), other[rows].reshape(-1, L, K))

    damping, rows = np.zeros(W), np.arange(W)
    residuals, cost = evaluated(windows, rows)
    taken_at = residuals if near is None else near.taken_at
    by_state = _derivatives(windows, world, residuals, n_threads=n_threads) if near is None else near.by_state
    best = _Estimate(windows, cost, residuals, taken_at, by_state)
    for _ in range(refine):
        some = best.windows.rows(rows)
        r = (best.residuals[rows] - center * other[rows]).reshape(-1, L, K)
        trial = _stepped(some, r, best.by_state[rows], other[rows].reshape(-1, L, K), damping[rows])
        trial_residuals, trial_cost = evaluated(trial, rows)
        better = trial_cost < best.cost[rows]
        falls = best.cost[rows] - trial_cost > settings.least_decrease
        damping[rows] = DAMPING.each(damping[rows], better)
        index = rows[better]
        best = replace(
            best,
            windows=_with_states(best.windows, index, trial.at_q[better], trial.at_v[better]),
            residuals=_with(best.residuals, index, trial_residuals[better]),
            cost=_with(best.cost, index, trial_cost[better]),
        )
        if near is None:
            best, _ = _with_derivatives(best, world, index, n_threads)
        rows = rows[falls | (~better & (damping[rows] < settings.most_damping))]
        if not len(rows):
            break
    return best


def _in_noise(at: Windows, by_state: Array | None, residuals: Array) -> tuple[Array, Array]:
    """Derivatives (W, K (L + 1), 2 K) and residuals (W, K (L + 1)) over the poses' whole error, which is whitened.

    The first recorded pose minus that of linearisation stands before the residuals (W, L, K), and its identity before
    the derivatives (W, L, K, 2 K).
    """
    W, K = len(residuals), at.channels
    if by_state is None:
        columns = np.zeros((W, 0, 0))
    else:
        first = np.broadcast_to(np.eye(K, 2 * K), (W, 1, K, 2 * K))
        stacked = np.concatenate([first, by_state], axis=1).transpose(0, 2, 1, 3)
        columns = (at.root @ stacked).reshape(W, -1, 2 * K)
    whole = np.concatenate([_deviation(at)[:, None, :K], residuals], axis=1).transpose(0, 2, 1)
    return columns, (at.root @ whole[..., None]).reshape(W, -1)


def _other_in_noise(at: Windows, other: Array) -> Array:
    """(W, K (L + 1)) the difference to the other engine (W, L, K), whitened as residuals are."""
    whole = np.concatenate([np.zeros_like(other[:, :1]), other], axis=1).transpose(0, 2, 1)
    out: Array = (at.root @ whole[..., None]).reshape(len(other), -1)
    return out


def _cost(at: Windows, residuals: Array, other: Array) -> Array:
    """(W,) -2 log posterior of first states, but for constants, with the best multiple of the other engine."""
    _, r = _in_noise(at, None, residuals)
    o = _other_in_noise(at, other)
    along = (o * r).sum(1) ** 2 / (1 + (o**2).sum(1))
    out: Array = np.minimum(r**2, 1e6).sum(1) - np.minimum(along, 1e6)
    return out + (_deviation(at)[:, at.channels :] ** 2 / at.prior[:, at.channels :] ** 2).sum(1)


def _stepped(at: Windows, residuals: Array, by_state: Array, other: Array, damping: Array) -> Windows:
    """First states after a Gauss-Newton step of 2 K numbers a window and the other engine's multiple.

    damping (W,): Marquardt's.
    """
    K, settings = at.channels, at.settings.whitening
    columns, r = _in_noise(at, by_state.reshape(len(by_state), -1, K, 2 * K), residuals)
    columns = np.concatenate([columns, _other_in_noise(at, other)[..., None]], axis=2)
    H, g = columns.mT @ columns, (columns.mT @ r[..., None])[..., 0]
    index, most = np.arange(2 * K + 1), _of_state(settings.largest_step, K)
    H[:, index[K:-1], index[K:-1]] += at.prior[:, K:] ** -2.0
    H[:, -1, -1] += 1.0
    g[:, K:-1] += _deviation(at)[:, K:] / at.prior[:, K:] ** 2
    H[:, index, index] *= 1 + damping[:, None]
    delta = np.linalg.solve(H, g[..., None])[:, :-1, 0]
    at_q, at_v = _moved(at.at_q, at.at_v, np.clip(delta, -most, most))
    return replace(at, at_q=at_q, at_v=at_v)


def _whitening(
    best: _Estimate, other: Array, center: float, near: Whitening | None, fresh: NDArray[np.bool_]
) -> Whitening:
    """The whitening of windows.

    Factors are those of `near` where no derivatives are fresh and the difference to the other engine is as it was.
    """
    windows, S = best.windows, best.by_state
    K = windows.channels
    mean = (S @ _deviation(windows)[..., None])[..., 0] + center * other
    mean[~np.repeat(windows.inside, K, axis=1)] = 0.0
    new = np.arange(len(S)) if near is None else np.flatnonzero(fresh | (other != near.other).any(1))
    some, by_pose = windows.rows(new), S[new, :, :K]
    (W, L), slow = some.inside.shape, some.slow
    # the first pose's own error (its noise and slow part), the first velocity's, and the other engine's multiple
    first = np.sqrt(some.prior[:, :K] ** 2 + slow[:, :, 0, 0])
    speeds = S[new, :, K:] * some.prior[:, None, K:]
    SP = np.concatenate([by_pose * first[:, None], speeds, other[new, :, None]], axis=2)
    cov = SP @ SP.mT
    index = np.arange(cov.shape[1])
    cov[:, index, index] += _variances(some)
    if slow.any():
        # rows' slow errors correlate with the first pose's
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
    return Whitening(root, mean, np.log(np.einsum("wii->wi", root)).sum(1), S, best.taken_at, other)


def _inverse_lower(factor: Array) -> Array:
    """Inverse of a lower triangular matrix; LAPACK's own is six times as fast as a general one."""
    inverse, status = dtrtri(factor, lower=1)
    if status:
        raise SolverError("a window's covariance is singular", total=1)
    return np.asarray(inverse)


def _derivatives(windows: Windows, world: World, residuals: Array, *, n_threads: int) -> Array:
    """(W, K L, 2 K) derivatives of predictions by first states, where residuals are (W, K L): one-sided differences."""
    (W, L), K = windows.inside.shape, windows.channels
    steps = _of_state(windows.settings.whitening.difference, K)
    # where the world is the same everywhere, predictions move along x and y with the first position
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
    moved = windows.residuals(run).reshape(len(q), W, K * L)
    S[..., given:] = np.moveaxis((residuals - moved) / steps[given:, None, None], 0, -1)
    return S


def _deviation(at: Windows) -> Array:
    """(W, 2 K) recorded first states minus those of linearisation."""
    return np.concatenate([difference(at.q, at.at_q), at.v - at.at_v], axis=1)


def _moved(q: Array, v: Array, delta: Array) -> tuple[Array, Array]:
    K = v.shape[1]
    return moved_pose(q, delta[:, :K]), v + delta[:, K:]


def _of_state(sizes: tuple[float, float, float, float], K: int) -> Array:
    """(2 K,) numbers for positions, rotations and joints, and their velocities."""
    position, rotation, velocity, spin = sizes
    return np.array([position] * 3 + [rotation] * (K - 3) + [velocity] * 3 + [spin] * (K - 3))
