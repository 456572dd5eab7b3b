"""How a component of the residual wrench depends on a state of the motion.

A curve of one component over one state is fitted and judged on tosses that took no part. The best of all pairs counts
only if signs drawn by toss rarely give as good a best pair (the maximum's own distribution; Westfall and Young 1993),
and the state only if it explains as rarely good beyond the component's mean.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import median_abs_deviation

from tossid.diagnosis.findings import Interval, Relation
from tossid.settings.diagnosis.diagnose import WrenchSettings

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]

COMPONENTS = (
    "force_x", "force_y", "force_z", "force_along", "force_left",
    "torque_x", "torque_y", "torque_z", "torque_spin", "torque_left",
)  # fmt: skip
"""Along x, y, z of the world (z up), along the horizontal velocity, horizontally to its left, along the spin. Objects
with joints have a torque in each, torque_joint_1 and so on, and none on the whole."""
STATES = (
    "time", "x", "y", "height", "lowest_corner", "velocity_x", "velocity_y", "velocity_z", "horizontal_speed",
    "speed", "spin", "spin_vertical",
)  # fmt: skip
"""Means over a window, but for the lowest corner, which is the deepest that any gets; SI units, the world's frame. And
the angle of each joint, from -pi to pi, and its rate: joint_1, joint_1_rate and so on."""


def components_of(count: int) -> tuple[str, ...]:
    """Names of components.

    Args:
        count: How many: those of `COMPONENTS`, and one a joint.
    """
    return COMPONENTS + tuple(f"torque_joint_{k + 1}" for k in range(count - len(COMPONENTS)))


def states_of(count: int) -> tuple[str, ...]:
    """Names of states.

    Args:
        count: How many: those of `STATES`, and two a joint.
    """
    joints = [f"joint_{k + 1}" for k in range((count - len(STATES)) // 2)]
    return (*STATES, *joints, *(f"{name}_rate" for name in joints))


def relate(
    phase: str,
    value: Array,
    variance: Array,
    states: Array,
    toss: NDArray[np.int64],
    rng: np.random.Generator,
    settings: WrenchSettings = WrenchSettings(),
) -> Relation | None:
    """The pair of component and state that explains most on tosses that took no part; None for too few windows.

    Args:
        phase: The windows' phase, in the result.
        value: (W, C) components [N], [N m].
        variance: (W, C) their variances; infinite where a component has no value.
        states: (W, S).
        toss: (W,) number of the toss.
        rng: For folds, signs and resamples.
        settings: How curves are fitted and judged.
    """
    numbers, toss = np.unique(toss, return_inverse=True)
    n, components, names = len(numbers), components_of(value.shape[1]), states_of(states.shape[1])
    signs = rng.choice([-1.0, 1.0], (n, settings.sign_flips))
    fold = rng.permutation(n) % settings.folds
    pick = rng.integers(0, n, (settings.resamples, n))
    samples = {}
    for k, component in enumerate(components):
        known = np.isfinite(variance[:, k])
        if known.sum() >= settings.fewest and len(np.unique(toss[known])) >= settings.fewest:
            y, weight = _weighted(value[known, k], variance[known, k], settings.outlier)
            samples[component] = _Sample(known, y, weight, toss[known], fold[toss[known]], n, settings)
    if not samples:
        return None
    scores, chance = {}, np.full(settings.sign_flips, -np.inf)
    for component, sample in samples.items():
        drawn = sample.with_flipped(sample.y, signs)
        for s in range(len(names)):
            _, share = sample.explained(states[sample.known, s], drawn)
            scores[component, s] = share[0]
            chance = np.maximum(chance, share[1:])
    component, s = max(scores, key=lambda pair: scores[pair])
    p_value = _p_value(chance, scores[component, s])

    best, k = samples[component], components.index(component)
    x = states[best.known, s]
    # the same beyond the component's mean: does it depend on a state at all?
    drawn = best.with_flipped(best.y - np.average(best.y, weights=best.weight), signs)
    chance = np.max([best.explained(states[best.known, i], drawn)[1][1:] for i in range(len(names))], axis=0)
    beyond, share = best.explained(x, drawn)
    p_state = _p_value(chance, share[0])
    r2, r2_state = best.interval(best.explained(x, best.y[:, None])[0], pick), best.interval(beyond, pick)
    clear = p_value <= settings.level and r2.low > 0
    state_clear = clear and p_state <= settings.level and r2_state.low > 0
    if clear and not state_clear:
        r2 = best.interval(best.explained(None, best.y[:, None])[0], pick)
    return Relation(
        phase=phase,
        windows=len(x),
        tosses=len(np.unique(best.toss)),
        component=component,
        state=names[s],
        r2=r2,
        p_value=p_value,
        clear=clear,
        r2_state=r2_state,
        p_state=p_state,
        state_clear=state_clear,
        means={name: each.mean(pick) for name, each in samples.items()},
        points=np.stack([x, value[best.known, k], np.sqrt(variance[best.known, k]), best.toss], axis=1),
        curve=best.curve(x, pick),
    )


def _p_value(chance: Array, share: float) -> float:
    """How often chance explains as much."""
    return float((1 + (chance >= share).sum()) / (1 + len(chance)))


def _weighted(y: Array, variance: Array, outlier: float) -> tuple[Array, Array]:
    """Values without outliers (n,), and weights (n,) by precision and by the scatter beyond it.

    The scatter between windows is that of DerSimonian and Laird (1986).
    """
    middle = np.median(y)
    far = outlier * float(median_abs_deviation(y, scale="normal")) + 1e-12
    y = np.clip(y, middle - far, middle + far)
    w = 1 / variance
    q = (w * (y - np.average(y, weights=w)) ** 2).sum()
    between = max(0.0, (q - (len(y) - 1)) / max(w.sum() - (w**2).sum() / w.sum(), 1e-300))
    return y, 1 / (variance + between)


@dataclass(frozen=True)
class _Sample:
    """The windows that determine one component.

    known: which of all windows; y: values; weight: their weights; toss: numbers of n tosses; fold: of these.
    """

    known: Flags
    y: Array
    weight: Array
    toss: NDArray[np.int64]
    fold: NDArray[np.int64]
    n: int
    settings: WrenchSettings

    def with_flipped(self, values: Array, signs: Array) -> Array:
        """(m, 1 + flips) values, and values with signs (n, flips) drawn by toss."""
        return values[:, None] * np.concatenate([np.ones((len(values), 1)), signs[self.toss]], axis=1)

    def _basis(self, x: Array, of: Array) -> Array:
        """(m, 2 or 3) 1, s and, of many windows, s²; s is the state over its standard deviation."""
        spread = max(float(of.std()), 1e-9)
        s = np.clip((x - of.mean()) / spread, -self.settings.range, self.settings.range)
        return np.stack([s**i for i in range(3 if len(of) >= self.settings.curved else 2)], axis=1)

    def explained(self, x: Array | None, Y: Array) -> tuple[Array, Array]:
        """How much a curve over x, or the mean if None, fitted to the other folds explains of every column of Y (m, c).

        Returns:
            Weighted squares of the first column by toss (n, 2), all and about the curve; and the share explained (c,).
        """
        X, after = np.ones((len(Y), 1)) if x is None else self._basis(x, x), np.empty_like(Y)
        for k in range(self.settings.folds):
            held = self.fold == k
            w = np.where(held, 0.0, self.weight)
            H = (X * w[:, None]).T @ X
            H += 1e-6 * np.trace(H) * np.eye(len(H))
            after[held] = Y[held] - X[held] @ np.linalg.solve(H, (X * w[:, None]).T @ Y)
        share: Array = 1 - self.weight @ after**2 / np.maximum(self.weight @ Y**2, 1e-300)
        return self._sums(np.stack([Y[:, 0] ** 2, after[:, 0] ** 2], axis=1)), share

    def _sums(self, values: Array) -> Array:
        """(n, ...) weighted sums over each toss's windows."""
        out = np.zeros((self.n, *values.shape[1:]))
        np.add.at(out, self.toss, self.weight.reshape(-1, *[1] * (values.ndim - 1)) * values)
        return out

    def interval(self, squares: Array, pick: NDArray[np.int64]) -> Interval:
        """The share explained, with its interval over tosses, of the squares of `explained`."""
        drawn = squares[pick].sum(1)
        low, high = np.percentile(1 - drawn[:, 1] / np.maximum(drawn[:, 0], 1e-300), [2.5, 97.5])
        whole, left = squares.sum(0)
        return Interval(float(1 - left / max(whole, 1e-300)), float(low), float(high))

    def mean(self, pick: NDArray[np.int64]) -> Interval:
        """Weighted mean, with its interval over tosses."""
        sums = self._sums(np.stack([self.y, np.ones_like(self.y)], axis=1))
        drawn = sums[pick].sum(1)
        low, high = np.percentile(drawn[:, 0] / np.maximum(drawn[:, 1], 1e-300), [2.5, 97.5])
        return Interval(float(sums[:, 0].sum() / sums[:, 1].sum()), float(low), float(high))

    def curve(self, x: Array, pick: NDArray[np.int64]) -> Array:
        """(40, 4) state, fitted component, and its 95 % band over tosses."""
        low, high = np.percentile(x, [1, 99])
        grid = np.linspace(low, high, 40)
        X, at = self._basis(x, x), self._basis(grid, x)
        A, b = self._sums(X[:, :, None] * X[:, None, :]), self._sums(X * self.y[:, None])
        ridge = 1e-6 * np.trace(A.sum(0)) * np.eye(X.shape[1])
        drawn = np.linalg.solve(A[pick].sum(1) + ridge, b[pick].sum(1)[..., None])[..., 0] @ at.T
        fitted = at @ np.linalg.solve(A.sum(0) + ridge, b.sum(0))
        return np.stack([grid, fitted, *np.percentile(drawn, [2.5, 97.5], axis=0)], axis=1)
