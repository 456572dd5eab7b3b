"""Fitting the parameters of effects to whitened misses, toss by toss robustly.

loss(z) = sum over entries of nu-Student's -log density of r / s_phase, r the whitened misses of the world at z.
s_phase >= 1 is what the simulator misses in a phase beyond noise: while an impact is badly modelled, its entries
must not drown what flight says. Fitted by Gauss-Newton with the density's weights (iteratively reweighted least
squares), derivatives by differences of whole predictions.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tossid.diagnosis.windows import Whitening, Windows
from tossid.physics.effects import Effect, World

Array = NDArray[np.float64]

NU = 4.0
"""Degrees of freedom of Student's density."""
N_PHASES = 6
ITERATIONS = 8
CONVERGED = 0.02
"""Change in units of the parameters' steps, or in standard errors, at which a fit ends."""


@dataclass(frozen=True)
class Hypothesis:
    """A world with effects added to it. values: one array (P,) an effect."""

    base: World
    effects: tuple[Effect, ...] = ()
    values: tuple[Array, ...] = ()

    def world(self) -> World:
        """The world with all effects at their values."""
        world = self.base
        for effect, values in zip(self.effects, self.values, strict=True):
            world = effect.at(world, values)
        return world

    def plus(self, effect: Effect, values: Array | None = None) -> Hypothesis:
        """With one effect more, at values that change nothing unless given."""
        if values is None:
            values = effect.nominal(self.world())
        return Hypothesis(self.base, (*self.effects, effect), (*self.values, values))

    def minus(self, name: str) -> Hypothesis:
        """Without the effect of that name."""
        kept = [(e, v) for e, v in zip(self.effects, self.values, strict=True) if e.name != name]
        return Hypothesis(self.base, tuple(e for e, _ in kept), tuple(v for _, v in kept))

    @property
    def steps(self) -> Array:
        """(P,) units of all parameters, in order."""
        return np.array([p.step for effect in self.effects for p in effect.parameters])

    @property
    def bounds(self) -> tuple[Array, Array]:
        """(P,) lowest and highest plausible values."""
        parameters = [p for effect in self.effects for p in effect.parameters]
        return np.array([p.low for p in parameters]), np.array([p.high for p in parameters])

    def flat(self) -> Array:
        """(P,) all values."""
        return np.concatenate(self.values) if self.values else np.zeros(0)

    def at(self, flat: Array) -> Hypothesis:
        """The same effects at other values (P,)."""
        parts, first = [], 0
        for effect in self.effects:
            parts.append(flat[first : first + len(effect.parameters)])
            first += len(effect.parameters)
        return Hypothesis(self.base, self.effects, tuple(parts))


@dataclass(frozen=True)
class Evidence:
    """Windows with their whitening, ready to judge worlds."""

    windows: Windows
    whitening: Whitening
    n_threads: int = 1

    def residual(self, world: World) -> Array:
        """(W, L, 6) whitened misses."""
        return self.whitening(self.windows.misses(self.windows.predicted(world, n_threads=self.n_threads)))

    def of_tosses(self, chosen: NDArray[np.bool_]) -> Evidence:
        """The windows of the tosses that are chosen (n_tosses,)."""
        rows = np.flatnonzero(chosen[self.windows.toss])
        w = self.whitening
        return Evidence(self.windows.rows(rows), Whitening(w.root[rows], w.mean[rows], w.volume[rows]), self.n_threads)

    def scales(self, residual: Array) -> Array:
        """(N_PHASES,) robust size of whitened misses a phase, at least 1."""
        out = np.ones(N_PHASES)
        for phase in range(N_PHASES):
            chosen = (self.windows.phase == phase) & self.windows.inside
            if chosen.any():
                out[phase] = max(1.0, _student_scale(residual[chosen].ravel()))
        return out

    def log_likelihood(self, residual: Array, scales: Array, n_tosses: int) -> Array:
        """(n_tosses,) of Student's density, but for constants."""
        s = scales[self.windows.phase][..., None]
        ll = -0.5 * (NU + 1) * np.log1p((residual / s) ** 2 / NU) - np.log(s)
        ll = np.where(self.windows.inside[..., None], ll, 0.0).sum((1, 2)) + self.whitening.volume
        return np.bincount(self.windows.toss, weights=ll, minlength=n_tosses).astype(float)


def _student_scale(r: Array) -> float:
    """Maximum likelihood scale of Student's density (a few fixed-point steps)."""
    s2 = max(float(np.median(r**2)) / 0.55, 1e-12)
    for _ in range(20):
        s2 = float(np.mean((NU + 1) * r**2 / (NU + r**2 / s2)))
    return float(np.sqrt(s2))


@dataclass(frozen=True)
class Fitted:
    """A fitted hypothesis, and Gauss-Newton's sums there, toss by toss, in units of the parameters' steps."""

    hypothesis: Hypothesis
    residual: Array
    scales: Array
    H: Array
    g: Array

    def of_part(self, part: NDArray[np.bool_]) -> Hypothesis:
        """The hypothesis at the values that the tosses of a part (n,) alone would have, to one Gauss-Newton step."""
        flat = self.hypothesis.flat()
        if not len(flat):
            return self.hypothesis
        low, high = self.hypothesis.bounds
        H, g = self.H[part].sum(0), self.g[part].sum(0)
        delta = -np.linalg.pinv(H + 1e-9 * np.trace(H) * np.eye(len(flat))) @ g
        return self.hypothesis.at(np.clip(flat + np.clip(delta, -50, 50) * self.hypothesis.steps, low, high))

    def covariance(self) -> Array:
        """Sandwich over tosses (P, P), in the parameters' own units."""
        n, size = self.g.shape
        total = self.H.sum(0)
        bread = np.linalg.pinv(total + 1e-9 * np.trace(total) / max(size, 1) * np.eye(size))
        centred = self.g - self.g.mean(0)
        meat = centred.T @ centred * n / max(n - size, 1)
        cov = bread @ meat @ bread
        # no better than the noise allows, however alike the tosses' slopes are
        cov += np.diag(np.maximum(np.diag(bread) - np.diag(cov), 0.0))
        steps = self.hypothesis.steps
        return cov * np.outer(steps, steps)


def derivatives(
    evidence: Evidence, hypothesis: Hypothesis, residual: Array, which: Sequence[int] | None = None
) -> Array:
    """(W, L, 6, P) of the whitened misses by the parameters, a step each; those not in `which` are 0."""
    flat, steps = hypothesis.flat(), hypothesis.steps
    _, high = hypothesis.bounds
    J = np.zeros((*residual.shape, len(flat)))
    for j in range(len(flat)) if which is None else which:
        sign = 1.0 if flat[j] + steps[j] <= high[j] else -1.0
        moved = flat.copy()
        moved[j] += sign * steps[j]
        J[..., j] = sign * (evidence.residual(hypothesis.at(moved).world()) - residual)
    return J


def toss_sums(evidence: Evidence, residual: Array, J: Array, scales: Array, n_tosses: int) -> tuple[Array, Array]:
    """Gauss-Newton's H (n, P, P) and g (n, P) of each toss, with Student's weights."""
    w = evidence.windows
    s = scales[w.phase][..., None]
    weight = (NU + 1) / (NU + (residual / s) ** 2) / s**2
    weight = np.where(w.inside[..., None], weight, 0.0)
    H_w = np.einsum("wlc,wlci,wlcj->wij", weight, J, J, optimize=True)
    g_w = np.einsum("wlc,wlci,wlc->wi", weight, J, residual, optimize=True)
    H, g = np.zeros((n_tosses, *H_w.shape[1:])), np.zeros((n_tosses, g_w.shape[1]))
    np.add.at(H, w.toss, H_w)
    np.add.at(g, w.toss, g_w)
    return H, g


def fit(
    evidence: Evidence,
    start: Hypothesis,
    *,
    n_tosses: int,
    scales: Array | None = None,
    iterations: int = ITERATIONS,
) -> Fitted:
    """Fit all parameters of a hypothesis.

    Args:
        scales: of the phases while fitting; those at the start if None. The result has its own.
    """
    hypothesis, steps = start, start.steps
    low, high = start.bounds
    residual = evidence.residual(hypothesis.world())
    scales = evidence.scales(residual) if scales is None else scales
    damping = 1e-3
    value = evidence.log_likelihood(residual, scales, n_tosses).sum()
    H, g = np.zeros((n_tosses, len(steps), len(steps))), np.zeros((n_tosses, len(steps)))
    for _ in range(iterations):
        J = derivatives(evidence, hypothesis, residual)
        H, g = toss_sums(evidence, residual, J, scales, n_tosses)
        total, slope, better = H.sum(0), g.sum(0), False
        for _ in range(5):
            lhs = total + damping * np.diag(np.diag(total)) + 1e-9 * max(np.trace(total), 1e-12) * np.eye(len(steps))
            delta = np.clip(-np.linalg.solve(lhs, slope), -100, 100)
            moved = hypothesis.at(np.clip(hypothesis.flat() + delta * steps, low, high))
            trial = evidence.residual(moved.world())
            now = evidence.log_likelihood(trial, scales, n_tosses).sum()
            if now > value:
                better = True
                break
            damping = max(damping, 1e-2) * 8
        if not better:
            break
        gain = now - value
        hypothesis, residual, value = moved, trial, now
        scales = np.minimum(scales, evidence.scales(residual))
        value = evidence.log_likelihood(residual, scales, n_tosses).sum()
        damping *= 0.2
        if gain < 0.05 or np.abs(delta).max() < CONVERGED:
            break
    J = derivatives(evidence, hypothesis, residual)
    H, g = toss_sums(evidence, residual, J, scales, n_tosses)
    return Fitted(hypothesis, residual, evidence.scales(residual), H, g)
