"""First states that suit the windows, and residuals whitened by how uncertain these are.

Each window's first state is a nuisance parameter. It is estimated by damped Gauss-Newton steps, window by window, and
its uncertainty becomes part of the residuals' covariance (see `windows`). The arithmetic is that of `innovations`.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

import numpy as np
from numpy.typing import NDArray

from tossid.diagnosis.likelihood.engine_discrepancy import EngineDifference
from tossid.diagnosis.likelihood.innovations import costs, factorise, gauss_newton, whiten
from tossid.diagnosis.likelihood.residuals import one_sided
from tossid.diagnosis.likelihood.states import difference as state_difference
from tossid.diagnosis.likelihood.states import moved_state, of_state
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

    def __call__(self, residuals: Array) -> Array:
        """(W, L, K) whitened residuals.

        Args:
            residuals: (W, L, K) as of `Windows.residuals`.
        """
        out = np.empty_like(residuals)
        every = np.arange(len(self.scale))
        whiten(every, residuals, self.mean, self.own, self.columns, self.gain, self.scale, out)
        return out

    def rows(self, index: Index) -> Whitening:
        """The whitening of some windows.

        Args:
            index: (n,) their numbers.
        """
        return Whitening(*(getattr(self, field.name)[index] for field in fields(self)))


def linearise(
    windows: Windows,
    world: World,
    *,
    steps: int = 2,
    restarts: int = 0,
    difference: EngineDifference | None = None,
    n_threads: int = 1,
) -> tuple[Windows, Whitening, Array]:
    """The windows at first states that their own frames determine under a world, and the whitening there.

    Args:
        windows: At first states from which to begin.
        world: The simulator.
        steps: Most Gauss-Newton steps of the first states, damped as by Marquardt.
        restarts: How often windows that fit poorly are restarted, from what their first frames determine, then from
            perturbed first states: where contact opens or closes, the posterior has several modes.
        difference: To another engine's predictions of the same rigid contact. Its multiple in the residuals is a
            nuisance parameter of standard deviation 1.
        n_threads: Of the simulator.

    Returns:
        The windows, the whitening, and the residuals (W, L, K) there.
    """
    n, settings = windows.channels * windows.inside.sum(1), windows.settings.whitening
    best = _Estimate(windows, world, *_other_engine(windows, difference), n_threads)
    best.refine(steps)
    best.renew(np.arange(len(n)))
    rng = np.random.default_rng(0)
    for turn in range(restarts):
        poor = np.flatnonzero(best.cost > n + settings.poor_fit * np.sqrt(2 * n))
        if not len(poor):
            break
        some = best.windows.rows(poor)
        if turn == 0:
            restarted = _followed(some, world, n_threads)
        else:
            at_q, at_v = moved_state(some.at_q, some.at_v, _perturbations(some, best.by_state[poor], rng))
            restarted = replace(some, at_q=at_q, at_v=at_v)
        # nearly right derivatives do not lead from one mode of an impact to another
        tried = _Estimate(restarted, world, best.other[poor], best.expected, n_threads, exact=True)
        tried.refine(settings.restart_steps)
        better = tried.cost < best.cost[poor]
        tried.renew(np.flatnonzero(better))
        best.take(poor[better], tried, better)
    return best.windows, best.whitening(np.arange(len(n))), best.residuals.reshape(windows.noise.shape)


def relinearise(
    windows: Windows,
    world: World,
    near: Whitening,
    *,
    steps: int,
    residuals: Array,
    moving: NDArray[np.bool_] | None = None,
    difference: EngineDifference | None = None,
    n_threads: int = 1,
) -> tuple[Windows, Whitening, Array]:
    """As `linearise`, from first states and derivatives of a world near by.

    Its derivatives are used in all steps. At the end they are computed anew where predictions have moved.

    Args:
        windows: At first states from which to begin.
        world: The simulator.
        near: The whitening there under a world near by.
        steps: Most Gauss-Newton steps of the first states.
        residuals: (W, L, K) of the world at these first states.
        moving: (W,) windows whose first states are refined; all if None.
        difference: As of `linearise`.
        n_threads: Of the simulator.
    """
    best = _Estimate(windows, world, *_other_engine(windows, difference), n_threads, near=near, residuals=residuals)
    best.refine(steps, moving)
    stale = best.renew(np.arange(len(near.other)))
    changed = (best.other != near.other).any(1)
    changed[stale] = True
    return best.windows, best.whitening(np.flatnonzero(changed), near), best.residuals.reshape(residuals.shape)


def _other_engine(windows: Windows, difference: EngineDifference | None) -> tuple[Array, float]:
    """The difference to the other engine (W, K L), and how many times it is expected in the residuals."""
    shape = (len(windows.q), windows.inside.shape[1] * windows.channels)
    return (np.zeros(shape), 0.0) if difference is None else (difference.values.reshape(shape), difference.expected)


class _Estimate:
    """First states of W windows on the way to the modes of their posteriors.

    Attributes:
        windows: At these first states.
        other: (W, K L) the difference to the other engine.
        expected: How many times it is expected in the residuals.
        residuals: (W, K L) there.
        cost: (W,) -2 log posterior, but for constants.
        by_state: (W, K L, 2 K) derivatives of predictions by first states.
        taken_at: (W, K L) residuals where these were taken.
    """

    def __init__(
        self,
        windows: Windows,
        world: World,
        other: Array,
        expected: float,
        n_threads: int,
        *,
        exact: bool = False,
        near: Whitening | None = None,
        residuals: Array | None = None,
    ) -> None:
        """At the windows' own first states.

        Args:
            windows: The windows.
            world: The simulator.
            other: The difference to the other engine.
            expected: How many times it is expected.
            n_threads: Of the simulator.
            exact: Whether derivatives are of the world itself, also where those of `World.by_first_states` cost less.
            near: Derivatives of a world near by, which stay while first states are refined.
            residuals: (W, L, K) at these first states, if they are known.
        """
        self.windows = replace(windows, at_q=windows.at_q.copy(), at_v=windows.at_v.copy())
        self.world, self.other, self.expected, self.n_threads, self.exact = world, other, expected, n_threads, exact
        every, q, v = np.arange(len(windows.q)), windows.at_q, windows.at_v
        self.residuals = self._residuals(q, v, every) if residuals is None else residuals.reshape(other.shape).copy()
        self.cost = self._costs(q, v, every, self.residuals)
        self._renews = near is None
        self.by_state = self._derivatives(every) if near is None else near.by_state.copy()
        self.taken_at = self.residuals.copy() if near is None else near.taken_at.copy()

    def refine(self, steps: int, moving: NDArray[np.bool_] | None = None) -> None:
        """Take damped Gauss-Newton steps. A window whose cost falls no more is left as it is.

        Derivatives are computed anew before a further step only: those at the end may be of the states before it.
        """
        w, settings = self.windows, self.windows.settings.whitening
        damping, most = np.zeros(len(w.q)), of_state(settings.largest_step, w.channels)
        rows = np.arange(len(w.q)) if moving is None else np.flatnonzero(moving)
        for turn in range(steps if len(rows) else 0):
            q, v, step = w.at_q[rows], w.at_v[rows], np.empty((len(rows), 2 * w.channels))
            gauss_newton(
                rows, self.residuals[rows], self.expected, self.other, w.root, self.by_state, _deviation(w, q, v, rows),
                w.prior, damping[rows], step,
            )  # fmt: skip
            q, v = moved_state(q, v, np.clip(step, -most, most))
            residuals = self._residuals(q, v, rows)
            cost = self._costs(q, v, rows, residuals)
            better, falls = cost < self.cost[rows], self.cost[rows] - cost > settings.least_decrease
            damping[rows] = DAMPING.each(damping[rows], better)
            index = rows[better]
            w.at_q[index], w.at_v[index] = q[better], v[better]
            self.residuals[index], self.cost[index] = residuals[better], cost[better]
            again, rows = rows[better & falls], rows[falls | (~better & (damping[rows] < settings.most_damping))]
            if not len(rows):
                break
            if self._renews and turn < steps - 1:
                self.renew(again)

    def renew(self, among: Index) -> Index:
        """Compute derivatives anew in those windows among some whose predictions have moved; which these are."""
        moved = np.abs(self.residuals[among] - self.taken_at[among]) / np.sqrt(self.windows.variances(among))
        stale = among[moved.max(1) > self.windows.settings.whitening.reuse_tolerance]
        if len(stale):
            self.by_state[stale], self.taken_at[stale] = self._derivatives(stale), self.residuals[stale]
        return stale

    def take(self, index: Index, other: _Estimate, better: NDArray[np.bool_]) -> None:
        """Take some rows as they are in another estimate, of whose rows the better ones count."""
        self.windows.at_q[index], self.windows.at_v[index] = other.windows.at_q[better], other.windows.at_v[better]
        for name in ("residuals", "cost", "by_state", "taken_at"):
            getattr(self, name)[index] = getattr(other, name)[better]

    def whitening(self, new: Index, near: Whitening | None = None) -> Whitening:
        """The whitening there. Factors of windows that are not new are those of another whitening."""
        w, (W, KL, K2) = self.windows, self.by_state.shape
        deviation = _deviation(w, w.at_q, w.at_v, np.arange(W))
        mean = (self.by_state @ deviation[..., None])[..., 0] + self.expected * self.other
        mean[~np.repeat(w.inside, w.channels, axis=1)] = 0.0
        shapes = ((W, KL, K2 + 1), (W, KL, K2 + 1), (W, KL), (W,))
        old = (None,) * 4 if near is None else (near.columns, near.gain, near.scale, near.log_det)
        factors = [np.empty(shape) if a is None else a.copy() for a, shape in zip(old, shapes, strict=True)]
        factorise(new, w.root, self.by_state, w.prior, self.other, *factors)
        columns, gain, scale, log_det = factors
        if not np.isfinite(log_det[new]).all():
            raise SolverError("a window's covariance is singular", total=1)
        return Whitening(w.root, columns, gain, scale, mean, log_det, self.by_state, self.taken_at, self.other)

    def _residuals(self, q: Array, v: Array, rows: Index) -> Array:
        """(n, K L) of some windows."""
        predicted = self.windows.predicted(self.world, q, v, rows, n_threads=self.n_threads)
        return self.windows.residuals(predicted, rows).reshape(len(rows), -1)

    def _costs(self, q: Array, v: Array, rows: Index, residuals: Array) -> Array:
        """(n,) of some windows."""
        w, out = self.windows, np.empty(len(rows))
        costs(rows, residuals, self.expected, self.other, w.root, _deviation(w, q, v, rows), w.prior, out)
        return out

    def _derivatives(self, rows: Index) -> Array:
        """(n, K L, 2 K) derivatives of some windows' predictions by first states: one-sided differences."""
        windows, K, n = self.windows, self.windows.channels, len(rows)
        world, residuals = self.world if self.exact else self.world.by_first_states, self.residuals[rows]
        if world is not self.world:
            predicted = windows.predicted(world, index=rows, n_threads=self.n_threads)
            residuals = windows.residuals(predicted, rows).reshape(n, -1)
        steps = of_state(windows.settings.whitening.difference, K)
        # where the world is the same everywhere, predictions move along x and y with the first position
        given = 2 if world.same_everywhere else 0
        count, every = 2 * K - given, np.tile(rows, 2 * K - given)
        delta = np.repeat(np.diag(steps)[given:], n, axis=0)
        q, v = moved_state(windows.at_q[every], windows.at_v[every], delta)
        run = windows.predicted(world, q, v, every, near=True, n_threads=self.n_threads)
        S = np.empty((n, residuals.shape[1], 2 * K))
        one_sided(residuals, windows.residuals(run, every).reshape(count, n, -1), steps, windows.inside[rows], S)
        return S


def first_frames(windows: Windows, share: float) -> Windows:
    """The windows with their first frames only.

    Args:
        windows: Any, but for long ones, in which a row is more than a frame (`Windows.steady`).
        share: Of the frames of each that are left, rounded up.
    """
    (W, L), F = windows.inside.shape, windows.mix.shape[2]
    later = np.arange(L) >= np.ceil(share * windows.inside.sum(axis=1))[:, None]
    mix = np.where(later[..., None], 0.0, windows.mix)
    beyond = np.append(np.zeros((W, 1), dtype=bool), later, axis=1)
    return replace(
        windows,
        steps=(np.arange(1, F + 1) * mix.any(axis=1)).max(axis=1),
        mix=mix,
        inside=windows.inside & ~later,
        noise=np.where(later[..., None], 1.0, windows.noise),
        # rows beyond are nobody's: neither residuals nor the errors of earlier rows enter them
        root=np.where(beyond[:, None, :, None], np.eye(L + 1), windows.root),
    )


def _followed(windows: Windows, world: World, n_threads: int) -> Windows:
    """Windows at first states that are followed from recorded ones while more and more of their frames take part.

    Over all frames of a window with contact, the posterior of its first state has several modes: after a slightly
    other state, another impact follows. Over the first few frames it has one. From there the mode is followed, as in
    continuation (Allgower and Georg, "Numerical Continuation Methods", 1990).
    """
    settings, at_q, at_v = windows.settings.whitening, windows.q.copy(), windows.v.copy()
    index = np.flatnonzero(~windows.steady)
    nothing = np.zeros((len(index), windows.inside[0].size * windows.channels))
    for share in settings.first_frames if len(index) else ():
        part = first_frames(replace(windows.rows(index), at_q=at_q[index], at_v=at_v[index]), share)
        there = _Estimate(part, world, nothing, 0.0, n_threads, exact=True)
        there.refine(settings.followed_steps)
        at_q[index], at_v[index] = there.windows.at_q, there.windows.at_v
    return replace(windows, at_q=at_q, at_v=at_v)


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


def _deviation(windows: Windows, at_q: Array, at_v: Array, rows: Index) -> Array:
    """(n, 2 K) recorded first states of some windows minus those at hand."""
    return np.concatenate([state_difference(windows.q[rows], at_q), windows.v[rows] - at_v], axis=1)
