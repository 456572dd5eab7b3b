"""Changes over an order, tested by permutation.

Each item i has a vector y_i with a standard deviation σ_i of its own error, the same along all axes. With scatter τ
between items, its weight is w_i = 1 / (σ_i² + τ²). About the robust mean c of all items, the scores

    g_i = u_i w_i^1/2 (y_i - c),      u_i = min(1, OUTLIER / |w_i^1/2 (y_i - c)|)

are of one size in all items: none counts more than another, however much it says of itself. (With w_i for w_i^1/2, the
score of a Gaussian likelihood, items that say little by that change are outweighed by the others.) Where the first k
of n items differ from the others, so do their scores: the statistic of a split is

    T_k = n / (k (n - k)) s_kᵀ V⁺ s_k,      s_k = g_1 + … + g_k,   V = Σ g_i g_iᵀ / n,

of scores about their mean, the score test of a change (Nyblom 1989). Its largest value over all splits is compared with
those of the same items in random orders (Good 2005): whatever the distribution of the items, p-values of an order that
means nothing are uniform. Quantities of one order are corrected for their number (Holm 1979), and parts are searched
again (binary segmentation).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from math import comb
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq
from scipy.stats import chi2

from tossid.robust import NORMAL_MAD, reweighted

Array = NDArray[np.float64]

SIGNIFICANCE = 0.005
"""Probability of finding any change in items whose order means nothing."""
ORDERS = (199, 3999)
"""Random orders: so many first, and all only where a change may be significant."""
FEWEST = 5
"""Items on each side of a change at least."""
OUTLIER = 3.0
"""Standard deviations beyond which an item counts no more than one at this distance."""
SEED = 1


class Sequence(NamedTuple):
    """Items in their order.

    Attributes:
        values: (n, d); NaN where the information is 0.
        info: Inverse variances of the items' own errors, (n,).
        covariates: What values may depend on beside the order, (n, m).
    """

    values: Array
    info: Array
    covariates: Array


@dataclass(frozen=True)
class Change:
    """A change between two items in a row.

    Attributes:
        at: The first item after it.
        p: By quantity that changed, the probability of such a change in an order that means nothing, corrected for the
            number of quantities.
    """

    at: int
    p: Mapping[str, float]


@dataclass(frozen=True, eq=False)
class Mean:
    """The robust mean of items.

    Attributes:
        value: The mean, (d,); NaN where no item says anything of it.
        cov: Its covariance, from the scatter of the items themselves, (d, d).
        scores: Of the items, whitened and bounded, (n, d).
        n: Items that say something.
    """

    value: Array
    cov: Array
    scores: Array
    n: int


def robust_mean(values: Array, info: Array) -> Mean:
    """The mean of items with errors of their own and scatter between them; its covariance is that of the items.

    Args:
        values: (n, d); NaN where the information is 0.
        info: Inverse variances of the items' own errors, (n,).
    """
    n, d = values.shape
    seen = info > 0
    if not seen.any():
        return Mean(np.full(d, np.nan), np.full((d, d), np.nan), np.zeros((n, d)), 0)
    y, var = values[seen], 1 / info[seen]
    center = np.median(y, axis=0)
    for _ in range(3):
        w = 1 / (var + _variance_between(y - center, var))

        def fit(u: Array, w: Array = w) -> tuple[Array, Array]:
            mean = (u * w) @ y / (u @ w)
            return mean, np.sqrt(np.maximum(w * ((y - mean) ** 2).sum(axis=1), 1e-300))

        center, u = reweighted(fit, len(y), limit=OUTLIER, iterations=20)
    g = (u * w)[:, None] * (y - center)
    scores = np.zeros((n, d))
    scores[seen] = (u * np.sqrt(w))[:, None] * (y - center)
    return Mean(center, g.T @ g / (u @ w) ** 2, scores, len(y))


def fewest_items(n_quantities: int) -> int:
    """The smallest number of items among which a change can be significant at all.

    Two halves of n items that differ by any amount are one of so many divisions of them; the probability of the order
    that was recorded cannot be less than that of one division.

    Args:
        n_quantities: That are corrected for.
    """
    n = 2 * FEWEST
    while 2 * n / comb(n, n // 2) > SIGNIFICANCE / n_quantities:
        n += 1
    return n


def find_changes(quantities: Mapping[str, Sequence]) -> tuple[Change, ...]:
    """Where quantities change over the order of items.

    Args:
        quantities: By name, of the same items in their order.

    Returns:
        The changes in their order.
    """
    rng = np.random.default_rng(SEED)
    found: list[Change] = []
    parts = [(0, len(next(iter(quantities.values())).values))]
    while parts:
        start, stop = parts.pop()
        part = {name: Sequence(*(array[start:stop] for array in each)) for name, each in quantities.items()}
        change = _clearest_change(part, rng)
        if change is not None:
            at = start + change.at
            found.append(Change(at, change.p))
            parts += [(start, at), (at, stop)]
    return tuple(sorted(found, key=lambda change: change.at))


def _clearest_change(quantities: Mapping[str, Sequence], rng: np.random.Generator) -> Change | None:
    """The clearest change of a stretch, if there is one."""
    n = len(next(iter(quantities.values())).values)
    if n < fewest_items(len(quantities)):
        return None
    scores = {name: own for name, each in quantities.items() if (own := _scores(each)) is not None}
    if not scores:
        return None
    splits = {name: _split_statistics(g) for name, g in scores.items()}
    above, (first, last) = dict.fromkeys(scores, 0), ORDERS
    for drawn in range(1, last + 1):
        order = rng.permutation(n)
        for name, g in scores.items():
            above[name] += int(_split_statistics(g[order]).max() >= splits[name].max())
        # after the first orders, nothing that is far from significant is pursued (Besag and Clifford 1991)
        if drawn == first and (1 + min(above.values())) / (1 + drawn) > 5 * SIGNIFICANCE:
            return None
    p = {name: (1 + count) / (1 + last) for name, count in above.items()}
    significant, worst = {}, 0.0
    for rank, name in enumerate(sorted(p, key=lambda name: p[name])):
        worst = max(worst, min(1.0, p[name] * (len(p) - rank)))
        if worst <= SIGNIFICANCE:
            significant[name] = worst
    if not significant:
        return None
    total = np.sum([splits[name] for name in significant], axis=0)
    return Change(FEWEST + int(np.argmax(total)), significant)


def _scores(each: Sequence) -> Array | None:
    """Bounded scores V^-1/2 g (n, d) about their mean, without what covariates explain; None of what does not vary."""
    values = _without_covariates(each)
    mean = robust_mean(values, each.info)
    if mean.n < 2 * FEWEST or np.ptp(values[np.isfinite(values[:, 0])], axis=0).max() == 0:
        return None
    g = mean.scores - mean.scores.mean(axis=0)
    # in the axes of V; what does not vary along one of them (a recording in a plane) counts nothing
    U, size, _ = np.linalg.svd(g, full_matrices=False)
    return np.asarray(np.sqrt(len(g)) * U[:, size > 1e-5 * size[0]])


def _split_statistics(scores: Array) -> Array:
    """T_k of every split with enough items on both sides, (n - 2 FEWEST + 1,), of scores (n, d)."""
    n = len(scores)
    k = np.arange(FEWEST, n - FEWEST + 1)
    sums = np.cumsum(scores, axis=0)[k - 1]
    return np.asarray((sums**2).sum(axis=1) * (n / (k * (n - k))))


def _without_covariates(each: Sequence) -> Array:
    """Values without what covariates explain by a robust linear regression: what depends on place is no change."""
    seen = each.info > 0
    m = each.covariates.shape[1]
    if seen.sum() < 4 * (m + 1):
        return each.values
    x = each.covariates[seen]
    X = np.column_stack([np.ones(len(x)), np.nan_to_num(x - np.nanmean(x, axis=0))])
    y = each.values[seen]

    def fit(weights: Array) -> tuple[Array, Array]:
        root = np.sqrt(weights)[:, None]
        B = np.linalg.lstsq(X * root, y * root, rcond=1e-6)[0]
        off = y - X @ B
        scale = NORMAL_MAD * np.median(np.abs(off), axis=0) + 1e-12
        return B, np.sqrt(((off / scale) ** 2).mean(axis=1))

    B, _ = reweighted(fit, len(y), limit=OUTLIER, iterations=10)
    out = each.values.copy()
    out[seen] = y - X[:, 1:] @ B[1:]
    return out


def _variance_between(off: Array, var: Array) -> float:
    """The variance between items that makes the median of their squared whitened distances that of χ².

    Args:
        off: Distances of the items from what they scatter about, (n, d).
        var: Variances of the items' own errors, (n,).
    """
    squares, median = (off**2).sum(axis=1), float(chi2.median(off.shape[1]))

    def excess(tau2: float) -> float:
        return float(np.median(squares / (var + tau2))) - median

    high = 10 * float(np.median(squares)) + 1e-30
    return float(brentq(excess, 0.0, high, rtol=1e-9)) if excess(0.0) > 0 > excess(high) else 0.0
