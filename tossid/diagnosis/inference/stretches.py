"""Stretches of tosses in the order of recording, in each of which an effect has values of its own.

When it is known what changes and where, all that steps is fitted together, to whole stretches: blocks of few tosses,
by which changes are found, end after few steps, and each change is found before the next one is known.
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
from tossid.diagnosis.inference.designs import FEWEST, steps_at
from tossid.diagnosis.inference.evidence import Evidence, collect
from tossid.diagnosis.inference.fitting import fit
from tossid.diagnosis.likelihood.windows import Windows, make_windows
from tossid.motion.resting import rest_scatter
from tossid.objects import ObjectModel
from tossid.physics.effects import Effect
from tossid.settings.diagnosis.likelihood import LikelihoodSettings
from tossid.types import Toss

Array = NDArray[np.float64]

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
