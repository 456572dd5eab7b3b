"""Fits of a hypothesis's parameters: damped Gauss-Newton steps, with first states that follow (variable projection).

Derivatives are central differences of whole predictions, two standard errors wide either way, over which the curvature
that contact's roughness has shall hold. A step is accepted by the robust gain of log-likelihood at the first states
before and after it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import t as student_t

from tossid.diagnosis.findings import Interval
from tossid.diagnosis.inference.columns import Columns, slopes, sums
from tossid.diagnosis.inference.evidence import Evidence, bounded
from tossid.diagnosis.inference.hypothesis import Hypothesis

Array = NDArray[np.float64]

DAMPINGS = (0.0, 0.1, 1.0, 10.0, 100.0)
"""Marquardt's, one after the other until a step gains."""
FURTHER = 3
"""How often a step that gains is doubled: first states that have not followed yet hold it back."""
NARROWEST, WIDEST = 0.5, 8.0
"""Central differences, in a parameter's declared steps: contact is rough at scales that no toss resolves."""
CONVERGED = 0.05
"""Change in standard errors, and gain, at which a fit ends."""


@dataclass(frozen=True)
class Fit:
    """A fitted hypothesis.

    Attributes:
        evidence: Of the hypothesis at the fitted values.
        columns: Of the parameters that were fitted, there.
        free: Numbers of these parameters.
        sizes: (P,) widths of the differences, in declared steps.
        n: How many tosses there are.
    """

    evidence: Evidence
    columns: Columns
    free: tuple[int, ...]
    sizes: Array
    n: int

    @property
    def hypothesis(self) -> Hypothesis:
        """At the fitted values."""
        return self.evidence.hypothesis

    def columns_of(self, name: str) -> list[int]:
        """Numbers of an effect's columns.

        Args:
            name: Of the effect.
        """
        owners = self.hypothesis.owners
        return [k for k, j in enumerate(self.free) if owners[j] == name]

    def optimism(self) -> Array:
        """(n,) what each toss's log-likelihood owes to its own part in the fit, by the step that leaves it out."""
        if not self.free:
            return np.zeros(self.n)
        return -self.columns.gains(self.columns.left_out() - self.columns.step())

    def widths(self) -> Array:
        """(P,) widths of the next central differences, in declared steps: two standard errors either way."""
        out = self.sizes.copy()
        four = 4.0 / np.sqrt(np.maximum(np.diagonal(self.columns.H.sum(0)), 1e-12))
        out[list(self.free)] = np.clip(four, NARROWEST, WIDEST)
        return out

    def moved(self, step: Array) -> Hypothesis:
        """The hypothesis moved in its free parameters, within their bounds.

        Args:
            step: (len(free),) in declared steps.
        """
        h = self.hypothesis
        move = np.zeros(len(h.flat()))
        move[list(self.free)] = np.clip(step, -100, 100)
        return h.at(h.flat() + move * h.steps)

    def from_nominal(self, name: str) -> Array:
        """Differences of an effect's values to those that change nothing, in declared steps.

        Args:
            name: Of the effect.
        """
        h = self.hypothesis
        place = h.place_of(name)
        return np.asarray((h.values_of(name) - h.nominal_of(name)) / h.steps[place])

    def intervals(self, name: str, further: Array | float = 0.0, degrees: int = 1) -> dict[str, Interval]:
        """An effect's parameters with 95 % intervals: Student's t of the jackknife over tosses, within their bounds.

        Args:
            name: Of the effect, whose values were fitted.
            further: (P,) variances beside that over tosses.
            degrees: Of freedom of the further variances. Those of the sum are Satterthwaite's (Biometrics 1946).
        """
        h, own = self.hypothesis, self.columns_of(name)
        place = h.place_of(name)
        over_tosses = np.maximum(np.diag(self.columns.covariance())[own], 0.0) * h.steps[place] ** 2
        whole = over_tosses + further
        share = further / np.maximum(whole, 1e-300)
        freedom = 1.0 / ((1.0 - share) ** 2 / max(self.n - 1, 1) + share**2 / degrees)
        half = student_t.ppf(0.975, freedom) * np.sqrt(whole)
        low, high = (bound[place] for bound in h.bounds)
        value = h.values_of(name)
        ends = zip(value, np.clip(value - half, low, high), np.clip(value + half, low, high), strict=True)
        parameters = h.effect(name).parameters
        return {p.name: Interval(*map(float, three)) for p, three in zip(parameters, ends, strict=True)}

    def correlation(self, name: str) -> tuple[tuple[float, ...], ...]:
        """(P, P) of the errors of an effect's parameters.

        Args:
            name: Of the effect, whose values were fitted.
        """
        own = self.columns_of(name)
        cov = self.columns.covariance()[np.ix_(own, own)]
        size = np.sqrt(np.maximum(np.diag(cov), 1e-300))
        return tuple(tuple(float(x) for x in row) for row in cov / np.outer(size, size))

    def wald(self, name: str) -> float:
        """Wald's statistic that an effect's values change nothing, by the sandwich covariance.

        Args:
            name: Of the effect.
        """
        own = self.columns_of(name)
        cov, away = self.columns.covariance()[np.ix_(own, own)], self.from_nominal(name)
        size = np.sqrt(np.maximum(np.diag(cov), 1e-300))
        return float(away / size @ np.linalg.pinv(cov / np.outer(size, size), hermitian=True) @ (away / size))


def fit(
    near: Evidence,
    start: Hypothesis,
    *,
    n: int,
    iterations: int,
    held: frozenset[str] = frozenset(),
    follow: int = 1,
    sizes: Array | None = None,
) -> Fit:
    """A hypothesis fitted from given values.

    Args:
        near: Evidence of a hypothesis near by.
        start: Values to begin with.
        n: How many tosses there are.
        iterations: Most steps.
        held: Names of effects whose values stay.
        follow: Gauss-Newton steps of first states at the start, which may be far from `near`.
        sizes: (P,) widths of the first differences, in declared steps; as wide as allowed if None.
    """
    evidence = near if start is near.hypothesis else near.relinearised(start, steps=follow)
    free = tuple(j for j, owner in enumerate(start.owners) if owner not in held)
    sizes = np.full(len(start.flat()), WIDEST) if sizes is None else sizes.copy()
    columns = sums(evidence, slopes(evidence, start, free, sizes), n)
    for _ in range(iterations):
        sizes = Fit(evidence, columns, free, sizes, n).widths()
        found = _step(Fit(evidence, columns, free, sizes, n))
        if found is None:
            break
        before, (evidence, gain) = evidence, found
        change = (evidence.hypothesis.flat() - before.hypothesis.flat())[list(free)] / start.steps[list(free)]
        moved = np.abs(change * np.sqrt(np.diagonal(columns.H.sum(0)))).max()
        columns = sums(evidence, slopes(evidence, evidence.hypothesis, free, sizes), n)
        if gain < CONVERGED or moved < CONVERGED:
            break
    return Fit(evidence, columns, free, sizes, n)


def _step(at: Fit) -> tuple[Evidence, float] | None:
    """The evidence after a damped step that gains, and its gain; None if no damping gains."""
    e = at.evidence
    H, g = at.columns.H.sum(0), at.columns.g.sum(0)
    scale = np.diag(H) + 1e-9 * max(np.trace(H), 1e-12)

    def gain_of(hypothesis: Hypothesis) -> float:
        """At the present first states."""
        return float(bounded(e.log_likelihood_of(hypothesis, e.scales) - e.log_likelihood, e.density).sum())

    for damping in DAMPINGS:
        step = -np.linalg.solve(H + np.diag((damping + 1e-9) * scale), g)
        moved = at.moved(step)
        gain = gain_of(moved)
        if not gain > 0:
            continue
        for _ in range(FURTHER):
            step = 2 * step
            further = at.moved(step)
            beyond = gain_of(further)
            if not beyond > gain:
                break
            moved, gain = further, beyond
        there = e.relinearised(moved)
        # half of the gain at the first states of before, half at those that have followed: neither side is ahead
        after = bounded(there.log_likelihood - there.log_likelihood_of(e.hypothesis, there.scales), e.density).sum()
        if gain + after > 0:
            return there, 0.5 * float(gain + after)
    return None
