"""First states that suit the windows, and residuals whitened by how uncertain these are.

Each window's first state is a nuisance parameter. It is estimated by damped Gauss-Newton steps, window by window, and
its uncertainty becomes part of the residuals' covariance (see `windows`). The arithmetic is that of `innovations`.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

import numpy as np
from numpy.typing import NDArray

from tossid.diagnosis.likelihood.engine_discrepancy import EngineDifference
from tossid.diagnosis.likelihood.first_frames import first_frames
from tossid.diagnosis.likelihood.innovations import costs, factorise, gauss_newton, whiten
from tossid.diagnosis.likelihood.residuals import one_sided
from tossid.diagnosis.likelihood.states import difference, moved_state, of_state
from tossid.diagnosis.likelihood.windows import Windows
from tossid.errors import SolverError
from tossid.least_squares import Damping
from tossid.physics.effects import World

Array = NDArray[np.float64]
Index = NDArray[np.int64]

DAMPING = Damping(grow=10.0, fall=0.1, least=0.1)
"""Marquardt's, of each window's first state."""


@dataclass(frozen=True)
class Whitening:
    """How the residuals of W windows are whitened, with R = 2 K + 1 numbers of which windows are uncertain.

    Attributes:
        own: (W, K, L + 1, L + 1) inverse Cholesky factors of each channel's own errors (`Windows.root`).
        columns: (W, K L, R) derivatives by the R numbers, in their standard deviations and after `own`.
        gain: (W, K L, R) by which each innovation changes the R numbers.
        scale: (W, K L) one over each innovation's standard deviation.
        mean: (W, K L) the residuals' mean under a right model.
        log_det: (W,) log determinants of the factors, without which densities of different whitenings do not compare.
        by_state: (W, K L, 2 K) derivatives of the predictions by the first states.
        taken_at: (W, K L) residuals where these derivatives were taken.
        other: (W, K L) the difference to the other engine.
        given_up: (W,) cost of a window's first state at which a restart has found none better; infinite without one.
    """

    own: Array
    columns: Array
    gain: Array
    scale: Array
    mean: Array
    log_det: Array
    by_state: Array
    taken_at: Array
    other: Array
    given_up: Array

    def __call__(self, residuals: Array, index: Index | None = None) -> Array:
        """(n, L, K) whitened residuals.

        Args:
            residuals: (n, L, K) as of `Windows.residuals`.
            index: (n,) of which windows; all W if None.
        """
        index = np.arange(len(self.scale)) if index is None else index
        out = np.empty_like(residuals)
        whiten(index, residuals, self.mean, self.own, self.columns, self.gain, self.scale, out)
        return out

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
        restarts: How often windows that fit poorly are restarted, from what their first frames determine, then from
            perturbed first states: where contact opens or closes, the posterior has several modes.
        near: The whitening under a world and first states near by. Its derivatives are used in all steps; at the end
            they are computed anew only for windows whose predictions have moved.
        update: Whether they are computed anew at the end.
        difference: To another engine's predictions of the same rigid contact. Its multiple in the residuals is a
            nuisance parameter of standard deviation 1.
        n_threads: Of the simulator.
    """
    kept, whitening, _ = linearised(
        windows, world, refine=refine, restarts=restarts, near=near, update=update, difference=difference,
        n_threads=n_threads,
    )  # fmt: skip
    return kept, whitening


def linearised(
    windows: Windows,
    world: World,
    *,
    refine: int = 2,
    restarts: int = 0,
    near: Whitening | None = None,
    update: bool = True,
    difference: EngineDifference | None = None,
    known: Array | None = None,
    moving: NDArray[np.bool_] | None = None,
    n_threads: int = 1,
) -> tuple[Windows, Whitening, Array]:
    """As `linearise`, with the residuals (W, L, K) that the world has at these first states.

    Args:
        windows: As of `linearise`, like the others.
        world: The simulator.
        refine: Most steps.
        restarts: Of windows that fit poorly.
        near: The whitening near by.
        update: Whether derivatives are computed anew.
        difference: To another engine's predictions.
        known: (W, L, K) residuals of the world at the windows' first states, if they are known.
        moving: (W,) windows whose first states are refined; all if None.
        n_threads: Of the simulator.
    """
    (W, L), K = windows.inside.shape, windows.channels
    settings = windows.settings.whitening
    other, center = (np.zeros((W, L, K)), 0.0) if difference is None else (difference.values, difference.expected)
    other = other.reshape(W, K * L)
    best = _estimate(windows, world, (other, center), refine, near, n_threads, known, moving)
    if near is None:
        best, _ = _with_derivatives(best, world, np.arange(W), n_threads)
    n = K * windows.inside.sum(1)
    rng = np.random.default_rng(0)
    fresh = np.full(W, near is None)
    given_up = np.full(W, np.inf) if near is None else near.given_up.copy()
    for turn in range(restarts):
        as_before = np.abs(best.cost - given_up) < settings.as_poor * best.cost
        poor = np.flatnonzero((best.cost > n + settings.poor_fit * np.sqrt(2 * n)) & (~as_before | (turn > 0)))
        if not len(poor):
            break
        some = best.windows.rows(poor)
        if turn == 0:
            begun = _followed(some, world, n_threads)
        else:
            at_q, at_v = moved_state(some.at_q, some.at_v, _perturbations(some, best.by_state[poor], rng))
            begun = replace(some, at_q=at_q, at_v=at_v)
        # nearly right derivatives do not lead from one mode of an impact to another
        tried = _estimate(begun, world, (other[poor], center), settings.restart_steps, None, n_threads, exact=True)
        better = tried.cost < best.cost[poor]
        tried, _ = _with_derivatives(tried, world, np.flatnonzero(better), n_threads, exact=True)
        given_up[poor] = np.where(better, np.inf, best.cost[poor])
        best = best.with_rows(poor[better], tried, better)
        fresh[poor[better]] = True
    if near is not None and update:
        best, stale = _with_derivatives(best, world, np.arange(W), n_threads)
        fresh[stale] = True
    whitening = _whitening(best, other, center, near, fresh)
    return best.windows, replace(whitening, given_up=given_up), best.residuals.reshape(W, L, K)


def _followed(windows: Windows, world: World, n_threads: int) -> Windows:
    """Windows at first states that are followed from recorded ones while more and more of their frames take part."""
    windows, settings = replace(windows, at_q=windows.q, at_v=windows.v), windows.settings.whitening
    index = np.flatnonzero(~windows.steady)
    nothing = np.zeros((len(index), windows.inside[0].size * windows.channels))
    for share in settings.first_frames if len(index) else ():
        part = first_frames(windows.rows(index), share)
        part = _estimate(part, world, (nothing, 0.0), settings.followed_steps, None, n_threads, exact=True).windows
        windows = _with_states(windows, index, part.at_q, part.at_v)
    return windows


def _with_derivatives(
    there: _Estimate, world: World, among: Index, n_threads: int, exact: bool = False
) -> tuple[_Estimate, Index]:
    """Derivatives computed anew in those windows among some whose predictions have moved since they were taken.

    Returns:
        The estimate with them, and which windows these are.
    """
    windows = there.windows
    moved = np.abs(there.residuals[among] - there.taken_at[among]) / np.sqrt(windows.variances(among))
    stale = among[moved.max(1) > windows.settings.whitening.reuse_tolerance]
    if len(stale):
        new = _derivatives(windows, world, there.residuals[stale], stale, exact=exact, n_threads=n_threads)
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
    """(W, 2 K) changes of first states, each by the same draw from its posterior, twice as wide."""
    W, K = len(by_state), at.channels
    # the identity of the first pose stands before the derivatives, and all is whitened by the poses' whole error
    first = np.broadcast_to(np.eye(K, 2 * K), (W, 1, K, 2 * K))
    stacked = np.concatenate([first, by_state.reshape(W, -1, K, 2 * K)], axis=1).transpose(0, 2, 1, 3)
    columns = (at.root @ stacked).reshape(W, -1, 2 * K)
    H = columns.mT @ columns
    speeds = np.arange(K, 2 * K)
    H[:, speeds, speeds] += at.prior[:, K:] ** -2.0
    # H = L L^T, so that L^-T z has covariance H^-1; one z for all, so that no window's draw depends on the others
    z = np.broadcast_to(rng.normal(size=(2 * K, 1)), (W, 2 * K, 1))
    return np.asarray(2 * np.linalg.solve(np.linalg.cholesky(H).mT, z)[..., 0], dtype=float)


def _estimate(
    windows: Windows,
    world: World,
    engine: tuple[Array, float],
    refine: int,
    near: Whitening | None,
    n_threads: int,
    known: Array | None = None,
    moving: NDArray[np.bool_] | None = None,
    exact: bool = False,
) -> _Estimate:
    """Windows at refined first states. A window whose cost falls no more is left as it is.

    Derivatives are computed anew before a further step only, so that those at the end may be of the states before it.

    engine: the difference to the other engine (W, K L), and how many times it is expected in the residuals.
    known: (W, L, K) residuals at the windows' own first states. moving: (W,) windows that are refined, all if None.
    exact: as of `_derivatives`.
    """
    (W, L), K = windows.inside.shape, windows.channels
    settings, (other, center) = windows.settings.whitening, engine
    most = of_state(settings.largest_step, K)

    def residuals_at(q: Array, v: Array, rows: Index) -> Array:
        """(n, K L) of some windows."""
        predicted = windows.predicted(world, q, v, rows, n_threads=n_threads)
        return windows.residuals(predicted, rows).reshape(len(rows), K * L)

    def cost_at(q: Array, v: Array, rows: Index, residuals: Array) -> Array:
        """(n,) of some windows."""
        out = np.empty(len(rows))
        deviation = _deviation(windows, q, v, rows)
        costs(rows, residuals, center, other, windows.root, deviation, windows.prior, out)
        return out

    damping, rows = np.zeros(W), np.arange(W)
    at_q, at_v = windows.at_q, windows.at_v
    residuals = residuals_at(at_q, at_v, rows) if known is None else known.reshape(W, K * L)
    cost = cost_at(at_q, at_v, rows, residuals)
    taken_at = residuals if near is None else near.taken_at
    if near is None:
        by_state = _derivatives(windows, world, residuals, rows, exact=exact, n_threads=n_threads)
    else:
        by_state = near.by_state
    best = _Estimate(windows, cost, residuals, taken_at, by_state)
    rows = rows if moving is None else np.flatnonzero(moving)
    for turn in range(refine if len(rows) else 0):
        here, step = best.windows, np.empty((len(rows), 2 * K))
        q, v = here.at_q[rows], here.at_v[rows]
        gauss_newton(
            rows, best.residuals[rows], center, other, here.root, best.by_state, _deviation(here, q, v, rows),
            here.prior, damping[rows], step,
        )  # fmt: skip
        q, v = moved_state(q, v, np.clip(step, -most, most))
        trial = residuals_at(q, v, rows)
        trial_cost = cost_at(q, v, rows, trial)
        better = trial_cost < best.cost[rows]
        falls = best.cost[rows] - trial_cost > settings.least_decrease
        damping[rows] = DAMPING.each(damping[rows], better)
        index = rows[better]
        best = replace(
            best,
            windows=_with_states(best.windows, index, q[better], v[better]),
            residuals=_with(best.residuals, index, trial[better]),
            cost=_with(best.cost, index, trial_cost[better]),
        )
        again, rows = rows[better & falls], rows[falls | (~better & (damping[rows] < settings.most_damping))]
        if not len(rows):
            break
        if near is None and turn < refine - 1:
            best, _ = _with_derivatives(best, world, again, n_threads, exact)
    return best


def _whitening(
    best: _Estimate, other: Array, center: float, near: Whitening | None, fresh: NDArray[np.bool_]
) -> Whitening:
    """The whitening of windows.

    Factors are those of `near` where no derivatives are fresh and the difference to the other engine is as it was.
    """
    windows, S = best.windows, best.by_state
    (W, KL, _), K = S.shape, windows.channels
    every = np.arange(W)
    deviation = _deviation(windows, windows.at_q, windows.at_v, every)
    mean = (S @ deviation[..., None])[..., 0] + center * other
    mean[~np.repeat(windows.inside, K, axis=1)] = 0.0
    if near is None:
        new, R = every, 2 * K + 1
        columns, gain = np.empty((W, KL, R)), np.empty((W, KL, R))
        scale, log_det = np.empty((W, KL)), np.empty(W)
    else:
        new = np.flatnonzero(fresh | (other != near.other).any(1))
        columns, gain, scale, log_det = near.columns, near.gain, near.scale, near.log_det
        if len(new):
            columns, gain, scale, log_det = columns.copy(), gain.copy(), scale.copy(), log_det.copy()
    if len(new):
        factorise(new, windows.root, S, windows.prior, other, columns, gain, scale, log_det)
        if not np.isfinite(log_det[new]).all():
            raise SolverError("a window's covariance is singular", total=1)
    return Whitening(windows.root, columns, gain, scale, mean, log_det, S, best.taken_at, other, np.full(W, np.inf))


def _derivatives(
    windows: Windows, world: World, residuals: Array, rows: Index, *, exact: bool = False, n_threads: int
) -> Array:
    """(n, K L, 2 K) derivatives of predictions by first states, where residuals are (n, K L): one-sided differences.

    rows: (n,) of which windows. exact: of the world itself, also where those of `World.by_first_states` cost less.
    """
    n, L, K = len(rows), windows.inside.shape[1], windows.channels
    near = world if exact else world.by_first_states
    if near is not world:
        world, residuals = near, windows.residuals(windows.predicted(near, index=rows, n_threads=n_threads), rows)
        residuals = residuals.reshape(n, K * L)
    steps = of_state(windows.settings.whitening.difference, K)
    # where the world is the same everywhere, predictions move along x and y with the first position
    given = 2 if world.same_everywhere else 0
    count = 2 * K - given
    delta = np.repeat(np.diag(steps)[given:], n, axis=0)
    every = np.tile(rows, count)
    q, v = moved_state(windows.at_q[every], windows.at_v[every], delta)
    run = windows.predicted(world, q, v, every, near=True, n_threads=n_threads)
    S = np.empty((n, K * L, 2 * K))
    one_sided(residuals, windows.residuals(run, every).reshape(count, n, K * L), steps, windows.inside[rows], S)
    return S


def _deviation(windows: Windows, at_q: Array, at_v: Array, rows: Index) -> Array:
    """(n, 2 K) recorded first states of some windows minus those at hand."""
    return np.concatenate([difference(windows.q[rows], at_q), windows.v[rows] - at_v], axis=1)
