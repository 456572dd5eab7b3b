"""How a component of the residual wrench depends on a state of the motion.

A curve of one component over one state is judged on each toss as the other tosses determine it. The best of all pairs
counts only if signs drawn by toss rarely give as good a best pair (the maximum's own distribution; Westfall and Young
1993), and the state only if it rarely explains as much beyond the component's mean.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import median_abs_deviation

from tossid.diagnosis.findings import RESAMPLES, Interval
from tossid.diagnosis.localisation.place import Relation

Array = NDArray[np.float64]
Index = NDArray[np.int64]

COMPONENTS = (
    "force_x", "force_y", "force_z", "force_along", "force_left",
    "torque_x", "torque_y", "torque_z", "torque_spin", "torque_left",
)  # fmt: skip
"""Along x, y, z of the world (z up), along the horizontal velocity, horizontally to its left, along the spin. Objects
with joints have the forces only."""
STATES = (
    "time", "x", "y", "height", "lowest_corner", "velocity_x", "velocity_y", "velocity_z", "horizontal_speed",
    "speed", "spin", "spin_vertical",
)  # fmt: skip
"""Means over a window, but for the lowest corner, which is the deepest that any gets; SI units, the world's frame."""

LEVEL = 0.01
"""Level of a clear relation."""
FLIPS = 499
"""Draws of signs by toss."""
FEWEST = 6
"""Tosses that must determine a component."""
CURVED = 30
"""Windows from which a curve is quadratic instead of straight."""
RANGE = 2.5
"""Standard deviations of a state beyond which a curve is level: few windows are there."""
OUTLIER = 6.0
"""Robust standard deviations to which a component is limited."""


def relate(
    phase: str, value: Array, variance: Array, states: Array, toss: Index, rng: np.random.Generator
) -> Relation | None:
    """The pair of component and state that explains most; None if too few tosses determine any component.

    Args:
        phase: The windows' phase, in the result.
        value: (W, C) components [N], [N m].
        variance: (W, C) their variances; infinite where a component has no value.
        states: (W, S).
        toss: (W,) number of the toss.
        rng: For signs and resamples.
    """
    numbers, toss = np.unique(toss, return_inverse=True)
    n = len(numbers)
    if n < FEWEST:
        return None
    # first what is there, then draws
    signs = np.concatenate([np.ones((n, 1)), rng.choice([-1.0, 1.0], (n, FLIPS))], axis=1)
    counts = np.concatenate([np.ones((1, n)), rng.multinomial(n, np.full(n, 1 / n), RESAMPLES)])
    samples = {}
    for k, component in enumerate(COMPONENTS[: value.shape[1]]):
        known = np.isfinite(variance[:, k])
        if len(np.unique(toss[known])) >= FEWEST:
            samples[component] = _Sample.of(value[known, k], variance[known, k], states[known], toss[known], n)
    if not samples:
        return None
    shares = np.array([each.shares(each.y, signs) for each in samples.values()])
    k, s = divmod(int(shares[..., 0].argmax()), shares.shape[1])
    p_value = _p_value(shares.max((0, 1)))

    component, best = list(samples.items())[k]
    beyond = best.y - np.average(best.y, weights=best.weight)
    shares = best.shares(beyond, signs)
    p_state = _p_value(np.append(shares[s, 0], shares[:, 1:].max(0)))
    r2, r2_state = best.explained(s, best.y, counts), best.explained(s, beyond, counts)
    clear = p_value <= LEVEL and r2.low > 0
    state_clear = clear and p_state <= LEVEL and r2_state.low > 0
    return Relation(
        phase=phase,
        windows=len(best.y),
        tosses=len(np.unique(best.toss)),
        component=component,
        state=STATES[s],
        r2=best.explained(None, best.y, counts) if clear and not state_clear else r2,
        p_value=p_value,
        clear=clear,
        r2_state=r2_state,
        p_state=p_state,
        state_clear=state_clear,
        means={name: each.mean(counts) for name, each in samples.items()},
        points=np.stack([best.states[:, s], best.value, np.sqrt(best.variance), best.toss], axis=1),
        curve=best.curve(s, counts),
    )


def _p_value(shares: Array) -> float:
    """How often what chance explains, all but the first, is as much as the first."""
    return float((shares >= shares[0]).mean())


@dataclass(frozen=True)
class _Sample:
    """The m windows that determine one component.

    value: (m,) as measured; variance: (m,) of these; y: (m,) the same without outliers; weight: (m,) by precision and
    by the scatter beyond it; states: (m, S); toss: (m,) number of the toss, of n.
    """

    value: Array
    variance: Array
    y: Array
    weight: Array
    states: Array
    toss: Index
    n: int

    @classmethod
    def of(cls, value: Array, variance: Array, states: Array, toss: Index, n: int) -> _Sample:
        """The scatter between windows is that of DerSimonian and Laird (1986)."""
        middle = np.median(value)
        far = OUTLIER * float(median_abs_deviation(value, scale="normal")) + 1e-12
        y, w = np.clip(value, middle - far, middle + far), 1 / variance
        q = (w * (y - np.average(y, weights=w)) ** 2).sum()
        between = max(0.0, (q - (len(y) - 1)) / max(w.sum() - (w**2).sum() / w.sum(), 1e-300))
        return cls(value, variance, y, 1 / (variance + between), states, toss, n)

    def _basis(self, s: int | None, x: Array | None = None) -> Array:
        """(m, 1 to 3) 1 and, over the state over its standard deviation, z and, of many windows, z²."""
        if s is None:
            return np.ones((len(self.y), 1))
        of = self.states[:, s]
        z = np.clip(((of if x is None else x) - of.mean()) / max(float(of.std()), 1e-9), -RANGE, RANGE)
        return np.stack([z**i for i in range(3 if len(of) >= CURVED else 2)], axis=1)

    def _by_toss(self, values: Array) -> Array:
        """(n, ...) weighted sums over each toss's windows."""
        out = np.zeros((self.n, *values.shape[1:]))
        np.add.at(out, self.toss, (self.weight * values.T).T)
        return out

    def _normal(self, X: Array, Y: Array) -> tuple[Array, Array, Array]:
        """Least squares of Y (m, c) on a basis (m, p): each toss's X'X (n, p, p) and X'Y (n, p, c), and a ridge."""
        A, b = self._by_toss(X[:, :, None] * X[:, None, :]), self._by_toss(X[:, :, None] * Y[:, None, :])
        return A, b, 1e-6 * np.trace(A.sum(0)) * np.eye(X.shape[1])

    def left(self, s: int | None, Y: Array) -> Array:
        """(m, c) what a curve over a state, or the mean if None, of the other tosses leaves of each toss's Y (m, c)."""
        X = self._basis(s)
        A, b, ridge = self._normal(X, Y)
        others = np.linalg.solve(A.sum(0) - A + ridge, b.sum(0) - b)
        out: Array = Y - np.einsum("mp,mpc->mc", X, others[self.toss])
        return out

    def shares(self, y: Array, signs: Array) -> Array:
        """(S, c) shares of the squares of y (m,), with signs (n, c) by toss, that a curve over each state explains."""
        Y = y[:, None] * signs[self.toss]
        whole = max(float(self.weight @ y**2), 1e-300)
        return np.array([1 - self.weight @ self.left(s, Y) ** 2 / whole for s in range(self.states.shape[1])])

    def explained(self, s: int | None, y: Array, counts: Array) -> Interval:
        """The share of the squares of y (m,) that a curve explains, with its interval over tosses."""
        whole, left = counts @ self._by_toss(y**2), counts @ self._by_toss(self.left(s, y[:, None])[:, 0] ** 2)
        shares = 1 - left / np.maximum(whole, 1e-300)
        return Interval.of(shares[0], shares[1:])

    def mean(self, counts: Array) -> Interval:
        """The component's mean, with its interval over tosses."""
        means = self.coefficients(None, counts)[:, 0]
        return Interval.of(means[0], means[1:])

    def coefficients(self, s: int | None, counts: Array) -> Array:
        """(r, p) of the curve over a state, or of the mean if None, in samples in which tosses count (r, n) times."""
        A, b, ridge = self._normal(self._basis(s), self.y[:, None])
        found = np.linalg.solve(np.tensordot(counts, A, 1) + ridge, np.tensordot(counts, b, 1))
        return np.asarray(found[..., 0], dtype=float)

    def curve(self, s: int, counts: Array) -> Array:
        """(40, 4) state, fitted component, and its 95 % band over tosses."""
        low, high = np.percentile(self.states[:, s], [1, 99])
        grid = np.linspace(low, high, 40)
        fitted, *drawn = self.coefficients(s, counts) @ self._basis(s, grid).T
        return np.stack([grid, fitted, *np.percentile(drawn, [2.5, 97.5], axis=0)], axis=1)
