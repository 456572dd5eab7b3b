"""Stretches of tosses in the order of recording, in each of which an effect has values of its own.

Where a change is large, derivatives at one hypothesis are rough. So the form is found by fits to blocks of few tosses.
When it is known what changes and where, all that steps is fitted together, to whole stretches: fits to blocks end after
few steps, and each change is found before the next one is known.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.stats import t as student_t

from tossid.diagnosis.findings import Interval
from tossid.diagnosis.inference.columns import Columns
from tossid.diagnosis.inference.designs import (
    FEWEST,
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
from tossid.diagnosis.likelihood.windows import Windows, make_windows
from tossid.motion.resting import rest_scatter
from tossid.objects import ObjectModel
from tossid.physics.effects import Effect
from tossid.settings.diagnosis.likelihood import LikelihoodSettings
from tossid.types import Toss

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
    """An effect that changes over the order.

    Attributes:
        effect: The effect.
        form: How.
        p_value: That any effect changes as clearly in an order that means nothing.
        gain: Of log-likelihood, over a constant value.
        stretches: Of steps, all; of a drift, the first toss and the last.
        rate: Of a drift, the change of each parameter from toss to toss.
        values: (n, P) its parameters in each toss.
    """

    effect: Effect
    form: Literal["steps", "drift"]
    p_value: float
    gain: float
    stretches: tuple[Stretch, ...]
    rate: dict[str, Interval]
    values: Array


@dataclass(frozen=True)
class Blocks:
    """An effect fitted to blocks of few tosses, in which derivatives hold however large a change is.

    Attributes:
        effect: The effect.
        columns: Its own, with derivatives in each block, of values counted from zero.
        values: (n, P) fitted, in declared steps.
        gain: Of log-likelihood, by all blocks.
    """

    effect: Effect
    columns: Columns
    values: Array
    gain: float

    @staticmethod
    def of(effect: Effect, fits: Sequence[Fit], gain: float) -> Blocks:
        """From fits to tosses that follow each other.

        Args:
            effect: The only one that was fitted.
            fits: Of the blocks.
            gain: Of log-likelihood, by all of them.
        """
        values, H, g = list[Array](), list[Array](), list[Array]()
        for each in fits:
            own = each.hypothesis.values_of(effect.name) / [p.step for p in effect.parameters]
            values.append(np.tile(own, (each.n, 1)))
            H.append(each.columns.H)
            g.append(each.columns.g - each.columns.H @ own)
        columns = Columns(np.concatenate(H), np.concatenate(g), fits[0].columns.curvature)
        return Blocks(effect, columns, np.concatenate(values), gain)

    def designed(self, design: Array, a: int = 0) -> Columns:
        """Columns of a design of some tosses.

        Args:
            design: (m, q).
            a: The first of the tosses.
        """
        b, own = a + len(design), np.arange(self.values.shape[1])
        return designed(self.columns.of_tosses(a, b), NO, own, design)

    def within(self, values: Array) -> Array:
        """Values within their bounds.

        Args:
            values: (..., P) in steps.
        """
        low, high, step = np.array([(p.low, p.high, p.step) for p in self.effect.parameters]).T
        return np.clip(values, low / step, high / step)

    def gain_of(self, design: Array) -> float:
        """Gain of log-likelihood by a design whose values in a toss the others determine.

        Args:
            design: (n, q).
        """
        steps = self.designed(design).left_out().reshape(len(design), design.shape[1], -1)
        values = self.within(np.einsum("nq,nqp->np", design, steps))
        return self.gain + float((self.columns.gains(values) - self.columns.gains(self.values)).sum())

    def form(self, known: Sequence[int], seed: int) -> tuple[int, ...] | None:
        """The edges of the stretches of steps; None for a drift, if that gains more.

        Args:
            known: First tosses of sessions of the dataset.
            seed: Of the orders that are drawn.
        """
        n, own = len(self.values), np.arange(self.values.shape[1])
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

    def cost(self, edges: Sequence[int] | None, known: Sequence[int]) -> float:
        """What the gain of a form owes to each toss's own part in the fit, and to moments that are chosen.

        Args:
            edges: Of the form.
            known: First tosses of sessions of the dataset.
        """
        some = self.designed(line_over(len(self.values)) if edges is None else steps_at(edges))
        own = float((some.gains(some.step()) - some.gains(some.left_out())).sum())
        return own if edges is None else own + _cost_of_moments(edges, known)

    def described(self, edges: Sequence[int] | None, p_value: float, gain: float) -> Change:
        """The change in a form, with intervals by the jackknife over the tosses that determine them.

        Args:
            edges: Of the form.
            p_value: That anything changes by chance.
            gain: Over a constant value.
        """
        effect, n, P = self.effect, len(self.values), self.values.shape[1]
        size = np.array([p.step for p in effect.parameters])

        def intervals(design: Array, a: int, rows: Array) -> list[dict[str, Interval]]:
            """Of rows (r, q) of combinations of the design's coefficients."""
            some = self.designed(design, a)
            B, out = some.step(), []
            cov = Columns(some.H, some.g + some.H @ B, some.curvature).covariance()
            t = student_t.ppf(0.975, max(len(design) - design.shape[1], 1))
            for row in rows:
                X = np.kron(row, np.eye(P))
                half = t * np.sqrt(np.maximum(np.diag(X @ cov @ X.T), 0.0)) * size
                ends = zip(effect.parameters, X @ B * size, half, strict=True)
                out.append({p.name: Interval(float(x), float(x - h), float(x + h)) for p, x, h in ends})
            return out

        design = line_over(n) if edges is None else steps_at(edges)
        values = self.within(design @ self.designed(design).step().reshape(-1, P)) * size
        if edges is None:
            first, last, rate = intervals(design, 0, np.array([design[0], design[-1], [0.0, 1.0]]))
            ends = (Stretch(0, 1, first), Stretch(n - 1, n, last))
            return Change(effect, "drift", p_value, gain, ends, rate, values)
        one = np.ones((1, 1))
        parts = (Stretch(a, b, intervals(np.ones((b - a, 1)), a, one)[0]) for a, b in pairwise(edges))
        return Change(effect, "steps", p_value, gain, tuple(parts), {}, values)


def _cost_of_moments(edges: Sequence[int], known: Sequence[int]) -> float:
    """Log n for each edge between tosses that is not of a known session."""
    return len({*edges[1:-1]} - {*known}) * float(np.log(edges[-1]))


def fitted_together(
    evidence: Evidence, changes: Sequence[Change], windows: Callable[[Sequence[int]], Windows] | None
) -> tuple[Change, ...]:
    """Steps with values that are fitted together, and intervals by the jackknife over all tosses.

    Args:
        evidence: Of all tosses, under the hypothesis beside which effects change.
        changes: Steps.
        windows: As of `order.over_order`.
    """
    names = {change.effect.name for change in changes}
    ends = [(*(stretch.first for stretch in change.stretches), len(change.values)) for change in changes]
    edges, H, g = sorted({edge for each in ends for edge in each}), list[Array](), list[Array]()
    all_windows = evidence.windows if windows is None else windows(edges)
    size = np.array([p.step for change in changes for p in change.effect.parameters])
    for a, b in pairwise(edges):
        h = evidence.hypothesis.without(*names)
        for change in changes:
            h = h.plus(change.effect, change.values[a])
        begun = collect(all_windows.of_tosses(np.arange(a, b)), h, n_threads=evidence.n_threads)
        made = fit(begun, h, n=b - a, iterations=ITERATIONS, held=frozenset({*h.names} - names))
        here = made.hypothesis.flat()[list(made.free)] / size
        H.append(made.columns.H)
        g.append(made.columns.g - made.columns.H @ here)
    # toss i has parameters E_i B, and B are those of all stretches of all changes
    E = _block_diagonal([_in_stretches(each, change) for each, change in zip(ends, changes, strict=True)])
    H_E = np.einsum("nia,nij,njb->nab", E, np.concatenate(H), E)
    columns = Columns(H_E, np.einsum("nia,ni->na", E, np.concatenate(g)), evidence.density.curvature)
    B, error = columns.step(), np.sqrt(np.diag(columns.covariance()))
    values, out, k, c = np.einsum("nia,a->ni", E, B) * size, list[Change](), 0, 0
    for each, change in zip(ends, changes, strict=True):
        stretches, parameters = list[Stretch](), change.effect.parameters
        for a, b in pairwise(each):
            t, named = float(student_t.ppf(0.975, b - a - 1)), dict[str, Interval]()
            for p in parameters:
                x, half = float(B[k] * p.step), t * float(error[k] * p.step)
                named[p.name] = Interval(x, x - half, x + half)
                k += 1
            stretches.append(Stretch(a, b, named))
        out.append(replace(change, stretches=tuple(stretches), values=values[:, c : c + len(parameters)]))
        c += len(parameters)
    return tuple(out)


def _in_stretches(edges: Sequence[int], change: Change) -> Array:
    """(n, P, q P) which parameters each toss has, of those of q stretches."""
    P = len(change.effect.parameters)
    return np.einsum("nq,ij->niqj", steps_at(edges), np.eye(P)).reshape(edges[-1], P, -1)


def _block_diagonal(blocks: Sequence[Array]) -> Array:
    """(n, sum of rows, sum of columns) of blocks (n, rows, columns)."""
    rows, columns = (np.cumsum([0, *(block.shape[axis] for block in blocks)]) for axis in (1, 2))
    out = np.zeros((len(blocks[0]), rows[-1], columns[-1]))
    for k, block in enumerate(blocks):
        out[:, rows[k] : rows[k + 1], columns[k] : columns[k + 1]] = block
    return out


def windows_within(
    tosses: Sequence[Toss],
    model: ObjectModel,
    edges: Sequence[int],
    *,
    settings: LikelihoodSettings = LikelihoodSettings(),
) -> Windows:
    """Windows of tosses, whose slow errors are what scatters within stretches of them.

    Args:
        tosses: In the order of recording.
        model: The stated object.
        edges: First tosses of the stretches, and the number of tosses. Those of fewer than `FEWEST` say nothing.
        settings: Of the windows.
    """
    parts = [tosses[a:b] for a, b in pairwise(edges) if b - a >= FEWEST] or [tosses]
    scatter = np.array([rest_scatter(part, model, over_order=True) for part in parts])
    height, turn = np.sqrt(np.average(scatter**2, axis=0, weights=[len(part) for part in parts])).tolist()
    return make_windows(tosses, model, settings=settings, scatter=(height, turn))
