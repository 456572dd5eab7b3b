"""Changes over the order of recording: an effect whose parameters in toss i are X_i B, by a design X (`designs`).

Where a change is large, derivatives at one hypothesis are rough. So its form is found by fits to blocks of few tosses.
When it is known what changes and where, all that steps is fitted together, to whole stretches: fits to blocks end after
few steps, and each change is found before the next one is known.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.stats import t as student_t

from tossid.diagnosis.findings import Interval
from tossid.diagnosis.inference.columns import Columns
from tossid.diagnosis.inference.designs import (
    LEVEL,
    change_p_values,
    designed,
    enough,
    gain_of,
    line_over,
    steps_at,
    with_step,
)
from tossid.diagnosis.inference.evidence import Evidence, collect
from tossid.diagnosis.inference.fitting import Fit, fit
from tossid.physics.effects import Effect

Array = NDArray[np.float64]
Index = NDArray[np.int64]

NO: Index = np.zeros(0, dtype=int)
"""Columns that are active beside a change: none."""

ITERATIONS = 8
"""Most steps of a fit to a stretch."""


@dataclass(frozen=True)
class Stretch:
    """Tosses in which an effect has the same values, from `first` to before `stop`; of a drift, one toss."""

    first: int
    stop: int
    values: dict[str, Interval]


@dataclass(frozen=True)
class Change:
    """An effect that changes over the order of n tosses.

    Attributes:
        effect: The effect.
        edges: First tosses of the stretches between which it steps, and n; None of a drift.
        p_value: That any effect changes as clearly in an order that means nothing.
        gain: Of log-likelihood, over a constant value.
        design: (n, q) X of its form.
        coefficients: (q, P) B.
        covariance: (q P, q P) of their errors.
    """

    effect: Effect
    edges: tuple[int, ...] | None
    p_value: float
    gain: float
    design: Array
    coefficients: Array
    covariance: Array

    @property
    def form(self) -> Literal["steps", "drift"]:
        """How it changes."""
        return "drift" if self.edges is None else "steps"

    @property
    def values(self) -> Array:
        """(n, P) its parameters in each toss, within their bounds."""
        low, high = np.array([(p.low, p.high) for p in self.effect.parameters]).T
        return np.clip(self.design @ self.coefficients, low, high)

    @property
    def stretches(self) -> tuple[Stretch, ...]:
        """Of steps, all; of a drift, the first toss and the last."""
        n = len(self.design)
        ends = ((0, 1), (n - 1, n)) if self.edges is None else pairwise(self.edges)
        return tuple(Stretch(a, b, self.combined(self.design[a])) for a, b in ends)

    @property
    def rate(self) -> dict[str, Interval]:
        """Of a drift, the change of each parameter from toss to toss."""
        return self.combined(np.array([0.0, 1.0])) if self.edges is None else {}

    def mean(self) -> dict[str, Interval]:
        """Its parameters, means over all tosses."""
        return self.combined(self.design.mean(0))

    def combined(self, row: Array) -> dict[str, Interval]:
        """A combination of the coefficients with its interval, by Student's t of the tosses that determine these.

        Args:
            row: (q,) factors.
        """
        used = (row != 0) | (self.edges is None)
        freedom = max(int(self.design[:, used].any(1).sum() - used.sum()), 1)
        P = len(self.effect.parameters)
        X = np.kron(row, np.eye(P))
        half = student_t.ppf(0.975, freedom) * np.sqrt(np.maximum(np.diag(X @ self.covariance @ X.T), 0.0))
        three = zip(self.effect.parameters, X @ self.coefficients.ravel(), half, strict=True)
        return {p.name: Interval(float(x), float(x - h), float(x + h)) for p, x, h in three}

    def shifted(self, by: Array) -> Change:
        """The same with all tosses' parameters changed alike.

        Args:
            by: (P,) their change.
        """
        constant = np.array([1.0, 0.0]) if self.edges is None else np.ones(len(self.coefficients))
        return replace(self, coefficients=self.coefficients + np.outer(constant, by))


def _in_si(effect: Effect, steps: Array, covariance: Array) -> tuple[Array, Array]:
    """(q, P) coefficients and their covariance (q P, q P), of those in an effect's declared steps."""
    size = np.resize([p.step for p in effect.parameters], len(steps))
    return (steps * size).reshape(-1, len(effect.parameters)), covariance * np.outer(size, size)


def form_over(edges: Sequence[int] | None, n: int) -> Array:
    """(n, q) the design of steps, or of a drift if there are no edges.

    Args:
        edges: First tosses of stretches, and n.
        n: How many tosses.
    """
    return line_over(n) if edges is None else steps_at(edges)


def from_zero(fits: Sequence[Fit], names: frozenset[str]) -> Columns:
    """Columns of effects that were fitted to tosses that follow each other, of values counted from zero.

    Args:
        fits: One after the other, with nothing else free.
        names: Of the effects.
    """
    H, g = np.concatenate([each.columns.H for each in fits]), list[Array]()
    for each in fits:
        h = each.hypothesis
        own = [j for j, owner in enumerate(h.owners) if owner in names]
        g.append(each.columns.g - each.columns.H @ (h.flat()[own] / h.steps[own]))
    return Columns(H, np.concatenate(g), fits[0].columns.curvature)


@dataclass(frozen=True)
class Blocks:
    """An effect fitted to blocks of few tosses, in which derivatives hold however large a change is.

    Attributes:
        effect: The effect.
        columns: Its own (n tosses, P), with derivatives in each block, of values counted from zero.
    """

    effect: Effect
    columns: Columns

    def designed(self, design: Array, a: int = 0) -> Columns:
        """Columns of a design of some tosses.

        Args:
            design: (m, q).
            a: The first of the tosses.
        """
        own = np.arange(self.columns.g.shape[1])
        return designed(self.columns.of_tosses(a, a + len(design)), NO, (own, design))

    def gain_of(self, design: Array) -> float:
        """Gain of log-likelihood over zero by a design whose values in a toss the others determine.

        Args:
            design: (n, q).
        """
        low, high, size = np.array([(p.low, p.high, p.step) for p in self.effect.parameters]).T
        steps = self.designed(design).left_out().reshape(len(design), design.shape[1], -1)
        values = np.clip(np.einsum("nq,nqp->np", design, steps), low / size, high / size)
        return float(self.columns.gains(values).sum())

    def form(self, known: Sequence[int], seed: int) -> tuple[int, ...] | None:
        """The edges of the stretches of steps; None for a drift, if that gains more.

        Args:
            known: First tosses of sessions of the dataset.
            seed: Of the orders that are drawn.
        """
        n, own = self.columns.n, np.arange(self.columns.g.shape[1])
        edges: tuple[int, ...] = (0, n)
        found = with_step(self.columns, NO, own, edges, known)[1]
        while found != edges:
            edges = found
            for a, b in pairwise(edges):
                part, inner = self.designed(np.ones((b - a, 1)), a), [k - a for k in known]
                if enough(b - a) and change_p_values([[(part, NO, own)]], inner, seed)[0][0] <= LEVEL:
                    more, cut = with_step(part, NO, own, (0, b - a), inner)
                    if more > gain_of(part, NO, own, np.ones((b - a, 1))):
                        found = tuple(sorted({*edges, *(a + k for k in cut)}))
                        break
        steps = self.gain_of(steps_at(edges)) - _cost_of_moments(edges, known)
        return None if self.gain_of(line_over(n)) > steps else edges

    def optimism(self, edges: Sequence[int] | None, known: Sequence[int]) -> float:
        """What the gain of a form owes to each toss's own part in the fit, and to moments that are chosen.

        Args:
            edges: Of the form.
            known: First tosses of sessions of the dataset.
        """
        some = self.designed(form_over(edges, self.columns.n))
        own = float((some.gains(some.step()) - some.gains(some.left_out())).sum())
        return own if edges is None else own + _cost_of_moments(edges, known)

    def change(self, edges: tuple[int, ...] | None, p_value: float) -> Change:
        """The change in a form, whose gain is not known yet.

        Args:
            edges: Of the form.
            p_value: That anything changes by chance.
        """
        design = form_over(edges, self.columns.n)
        columns = self.designed(design)
        in_si = _in_si(self.effect, columns.step(), columns.covariance())
        return Change(self.effect, edges, p_value, 0.0, design, *in_si)


def _cost_of_moments(edges: Sequence[int], known: Sequence[int]) -> float:
    """Log n for each edge between tosses that is not of a known session."""
    return len({*edges[1:-1]} - {*known}) * float(np.log(edges[-1]))


def fitted_together(evidence: Evidence, changes: Sequence[Change]) -> tuple[Change, ...]:
    """Steps with values that are fitted together; drifts are left as they are if there are any.

    Args:
        evidence: Of all tosses, under the hypothesis beside which effects change.
        changes: Of effects.
    """
    if not changes or any(change.edges is None for change in changes):
        return tuple(changes)
    names = frozenset(change.effect.name for change in changes)
    edges, fits = sorted({edge for change in changes for edge in change.edges or ()}), list[Fit]()
    for a, b in pairwise(edges):
        h = evidence.hypothesis.without(*names)
        for change in changes:
            h = h.plus(change.effect, change.values[a])
        start = collect(evidence.windows.of_tosses(np.arange(a, b)), h, n_threads=evidence.n_threads)
        fits.append(fit(start, h, n=b - a, iterations=ITERATIONS, held=frozenset({*h.names} - names)))
    owners = np.array([owner for owner in fits[0].hypothesis.owners if owner in names])
    own = (np.flatnonzero(owners == change.effect.name) for change in changes)
    columns = designed(from_zero(fits, names), NO, *zip(own, (change.design for change in changes), strict=True))
    steps, covariance, out, first = columns.step(), columns.covariance(), list[Change](), 0
    for change in changes:
        part = slice(first, first + change.coefficients.size)
        B, cov = _in_si(change.effect, steps[part], covariance[part, part])
        out.append(replace(change, coefficients=B, covariance=cov))
        first = part.stop
    return tuple(out)
