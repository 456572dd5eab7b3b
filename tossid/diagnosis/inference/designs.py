"""Designs: how an effect goes over the order of tosses, and whether that is by chance. No simulation is needed.

A design X (n, q) is a column of ones (the effect is the same in all tosses), one for each stretch of tosses, or ones
and the centred order. Toss i has the effect's parameters theta_i = X_i B. So the sums H_i, g_i of `Columns` become sums
by B, and steps, tosses left out, gains and the jackknife follow.

Whether anything changes is tested by permutation, since the order means nothing where nothing changes. Tosses have
scores beside a constant value of the effect, of which the normal scores of the ranks are taken, so that no toss
decides. The clearest of all effects and places in each drawn order is the distribution of chance (Westfall and Young
1993).
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from itertools import pairwise
from math import comb

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2, norm, rankdata

from tossid.diagnosis.inference.columns import Columns

Array = NDArray[np.float64]
Index = NDArray[np.int64]

LEVEL = 0.005
"""How often something is said to change where nothing does."""
FIRST, ORDERS = 199, 1999
"""Orders that are drawn beside the recorded one: these first, and so many only where something may change."""
NO_DOUBT = 0.05
"""P-value by the first orders above which no others are drawn."""
FEWEST = 5
"""Tosses of a stretch."""
Where = tuple[Columns, Index, Index]
"""Columns of tosses in the order of recording, the numbers of the active ones, and those of an effect's own."""


def designed(columns: Columns, active: Index, *changing: tuple[Index, Array]) -> Columns:
    """Columns of active parameters, and of the coefficients B of effects whose parameters are X_i B in toss i.

    Args:
        columns: Of all.
        active: (A,) numbers of the columns whose parameters are the same in all tosses.
        *changing: Of each effect, (P,) numbers of its columns, and its design X (n, q). It has q P coefficients.
    """
    part, n = columns.part(np.concatenate([active, *(own for own, _ in changing)])), columns.n
    every = [(len(active), np.ones((n, 1))), *((len(own), X) for own, X in changing)]
    E, row, column = np.zeros((n, part.g.shape[1], sum(P * X.shape[1] for P, X in every))), 0, 0
    for P, X in every:
        width = P * X.shape[1]
        block = np.einsum("nq,ij->niqj", X, np.eye(P)).reshape(n, P, width)
        E[:, row : row + P, column : column + width] = block
        row, column = row + P, column + width
    return Columns(np.einsum("nia,nij,njb->nab", E, part.H, E), np.einsum("nia,ni->na", E, part.g), part.curvature)


def steps_at(edges: Sequence[int]) -> Array:
    """(n, q) which of q stretches each toss is of.

    Args:
        edges: (q + 1,) first tosses of the stretches, and n.
    """
    return np.asarray(np.eye(len(edges) - 1)[np.searchsorted(edges, np.arange(edges[-1]), side="right") - 1])


def line_over(n: int) -> Array:
    """(n, 2) ones, and the order about its mean.

    Args:
        n: How many tosses.
    """
    return np.stack([np.ones(n), np.arange(n) - 0.5 * (n - 1)], axis=1)


def gain_of(columns: Columns, active: Index, own: Index, design: Array) -> float:
    """Leave-one-out gain of a design.

    Args:
        columns: Of all.
        active: Numbers of the active columns.
        own: Numbers of the effect's columns.
        design: (n, q).
    """
    some = designed(columns, active, (own, design))
    return float(some.gains(some.left_out()).sum())


def enough(n: int) -> bool:
    """Whether tosses can show a change at all: a division of them into halves is one of so many.

    Args:
        n: How many.
    """
    return n >= 2 * FEWEST and 2 / comb(n, n // 2) <= LEVEL


def normal_scores(columns: Columns, active: Index, own: Index) -> Array:
    """(n, r) uncorrelated scores of tosses by rank, beside the active columns and a constant value.

    Args:
        columns: Of all.
        active: Numbers of the active columns.
        own: Numbers of the effect's columns.
    """
    joint = designed(columns, active, (own, np.ones((columns.n, 1))))
    after = Columns(joint.H, joint.g + joint.H @ joint.step(), joint.curvature)
    raw, _ = after.scores(np.arange(len(active), joint.g.shape[1]), np.arange(len(active)))
    size = np.sqrt(columns.H[:, own, own])
    each = np.where(size > 1e-6 * size.max(0), raw / np.maximum(size, 1e-300), 0.0)
    score = norm.ppf(rankdata(each, axis=0) / (len(each) + 1))
    score = score - score.mean(0)
    w, Q = np.linalg.eigh(score.T @ score / (len(score) - 1))
    kept = w > 1e-6
    return np.asarray(score @ Q[:, kept] / np.sqrt(w[kept]))


def clearness(scores: Array, orders: Index, boundaries: Iterable[int] = ()) -> tuple[Array, int]:
    """How clear a change is in each order (F,), as -log p, and the clearest first toss of a step in the first order.

    Args:
        scores: (n, r) of `normal_scores`.
        orders: (F, n) of the tosses.
        boundaries: First tosses of known sessions, whose places need not be sought.
    """
    (n, r), k = scores.shape, np.arange(FEWEST, len(scores) - FEWEST + 1)
    if r == 0:
        return np.zeros(len(orders)), n // 2
    ordered, t = scores[orders], line_over(n)[:, 1]
    steps = (np.cumsum(ordered, axis=1)[:, k - 1] ** 2).sum(-1) * (n / (k * (n - k)))
    line = np.einsum("i,fir->fr", t, ordered) ** 2 / (t @ t)
    # a place that is sought among so many counts so much less than a known one
    tests = [-chi2.logsf(steps.max(1), r) - np.log(len(k)), -chi2.logsf(line.sum(1), r)]
    tests += [-chi2.logsf(steps[:, b - FEWEST], r) for b in boundaries if FEWEST <= b <= n - FEWEST]
    return np.max(tests, axis=0), int(k[steps[0].argmax()])


def change_p_values(effects: Sequence[Sequence[Where]], boundaries: Iterable[int], seed: int) -> tuple[Array, Array]:
    """P-values (m,) that effects change over the order, adjusted for all of them, and the clearest places (m,).

    Args:
        effects: Of each of m effects, where its columns are, for each of its starts.
        boundaries: First tosses of known sessions.
        seed: Of the orders.
    """
    scores = [[normal_scores(*each) for each in starts] for starts in effects]
    n, known, rng = len(scores[0][0]), tuple(boundaries), np.random.default_rng(seed)
    drawn = rng.permuted(np.tile(np.arange(n), (ORDERS, 1)), axis=1)
    for count in (FIRST, ORDERS):
        orders = np.concatenate([np.arange(n)[None], drawn[:count]])
        found = [[clearness(each, orders, known) for each in starts] for starts in scores]
        clear = np.array([np.max([c for c, _ in starts], axis=0) for starts in found])
        p_values = (clear.max(0) >= clear[:, :1] * (1 - 1e-9)).mean(1)
        if p_values.min() > NO_DOUBT:
            break
    place = np.array([max(starts, key=lambda each: each[0][0])[1] for starts in found])
    return p_values, place


def with_step(
    columns: Columns, active: Index, own: Index, edges: Sequence[int], known: Sequence[int]
) -> tuple[float, tuple[int, ...]]:
    """The gain by the best further edge, and all edges. A moment that is not known costs log n (Schwarz 1978).

    Args:
        columns: Of all.
        active: Numbers of the active columns.
        own: Numbers of the effect's columns.
        edges: First tosses of the stretches that there are, and n.
        known: First tosses of sessions of the dataset.
    """
    best: tuple[float, tuple[int, ...]] = -np.inf, tuple(edges)
    for k in (k for a, b in pairwise(edges) for k in range(a + FEWEST, b - FEWEST + 1)):
        tried = tuple(sorted({*edges, k}))
        gain = gain_of(columns, active, own, steps_at(tried)) - (0.0 if k in known else float(np.log(columns.n)))
        best = max(best, (gain, tried), key=lambda each: each[0])
    return best
