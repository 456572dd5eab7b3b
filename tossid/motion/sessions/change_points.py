"""Changes over an order, tested by permutation.

Each item i has a vector y_i with information A_i (the inverse covariance of its own error; 0 where it says nothing).
With scatter tau between items, its weight is W_i = A_i (1 + tau² A_i)^-1. About the robust mean c of all items, the
scores

    g_i = u_i W_i^1/2 (y_i - c),      u_i = min(1, OUTLIER / |W_i^1/2 (y_i - c)|)

are of one size in all items: none counts more than another, however much it says of itself. (With W_i for W_i^1/2, the
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
BLOCK = 1 << 22
"""Numbers in memory while random orders are looked at."""


class Sequence(NamedTuple):
    """Items in their order.

    Attributes:
        values: (n, d); NaN where the information is 0.
        info: Inverse covariances of the items' own errors, (n, d, d).
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
    """The mean of items with errors of their own and scatter between them; its covariance is clustered by item.

    Args:
        values: (n, d); NaN where the information is 0.
        info: Inverse covariances of the items' own errors, (n, d, d).
    """
    n, d = values.shape
    rank = np.linalg.matrix_rank(info, hermitian=True)
    seen = rank > 0
    if not seen.any():
        return Mean(np.full(d, np.nan), np.full((d, d), np.nan), np.zeros((n, d)), 0)
    y, A = values[seen], info[seen]
    center = np.median(y, axis=0)
    for _ in range(3):
        tau2, start = _variance_between(y - center, A, rank[seen]), center
        W = A @ np.linalg.inv(np.eye(d) + tau2 * A)

        def fit(u: Array, W: Array = W, start: Array = start) -> tuple[tuple[Array, Array], Array]:
            H = np.einsum("n,nij->ij", u, W)
            mean = start + np.linalg.lstsq(H, np.einsum("n,nij,nj->i", u, W, y - start), rcond=1e-10)[0]
            return (mean, H), np.sqrt(np.maximum(_squares(y - mean, W), 1e-300))

        (center, H), u = reweighted(fit, len(y), limit=OUTLIER, iterations=20)
    g = u[:, None] * np.einsum("nij,nj->ni", W, y - center)
    inverse = np.linalg.pinv(H, rcond=1e-10, hermitian=True)
    scores = np.zeros((n, d))
    scores[seen] = u[:, None] * np.einsum("nij,nj->ni", _root(W), y - center)
    return Mean(center, inverse @ (g.T @ g) @ inverse, scores, len(y))


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
    above = dict.fromkeys(scores, 0)
    most = max(1, BLOCK // (n * sum(g.shape[1] for g in scores.values())))
    drawn, (first, last) = 0, ORDERS
    while drawn < last:
        # after the first orders, nothing that is far from significant is pursued (Besag and Clifford 1991)
        if drawn >= first and (1 + min(above.values())) / (1 + drawn) > 5 * SIGNIFICANCE:
            return None
        count = min(first if drawn == 0 else last - drawn, most)
        orders = rng.permuted(np.tile(np.arange(n), (count, 1)), axis=1)
        for name, g in scores.items():
            above[name] += int(np.sum(_split_statistics(g[orders]).max(axis=-1) >= splits[name].max()))
        drawn += count
    p = {name: (1 + count) / (1 + drawn) for name, count in above.items()}
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
    """Whitened and bounded scores (n, d), without what covariates explain; None of what does not vary."""
    values = _without_covariates(each)
    mean = robust_mean(values, each.info)
    varies = mean.n >= 2 * FEWEST and np.ptp(values[np.isfinite(values[:, 0])], axis=0).max() > 0
    return mean.scores if varies else None


def _split_statistics(scores: Array) -> Array:
    """T_k of every split with enough items on both sides, (..., n - 2 FEWEST + 1), of scores (..., n, d)."""
    n = scores.shape[-2]
    k = np.arange(FEWEST, n - FEWEST + 1)
    centred = scores - scores.mean(axis=-2, keepdims=True)
    first = centred.reshape(-1, *centred.shape[-2:])[0]  # V is the same in any order
    root = _root(np.linalg.pinv(first.T @ first / n, rcond=1e-10, hermitian=True))
    sums = np.cumsum(centred @ root, axis=-2)[..., k - 1, :]
    return np.asarray((sums**2).sum(axis=-1) * (n / (k * (n - k))))


def _without_covariates(each: Sequence) -> Array:
    """Values without what covariates explain by a robust linear regression: what depends on place is no change."""
    seen = np.trace(each.info, axis1=1, axis2=2) > 0
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


def _variance_between(off: Array, info: Array, rank: NDArray[np.int64]) -> float:
    """The variance between items that makes the median of their squared whitened distances that of χ².

    Args:
        off: Distances of the items from what they scatter about, (n, d).
        info: Inverse covariances of the items' own errors, (n, d, d).
        rank: Of these, (n,).
    """

    def excess(tau2: float) -> float:
        W = info @ np.linalg.inv(np.eye(off.shape[1]) + tau2 * info)
        return float(np.median(chi2.cdf(_squares(off, W), rank))) - 0.5

    high = float(np.sum(np.median(off**2, axis=0))) * 10 + 1e-30
    return float(brentq(excess, 0.0, high, rtol=1e-9)) if excess(0.0) > 0 > excess(high) else 0.0


def _squares(off: Array, W: Array) -> Array:
    """off_iᵀ W_i off_i, (n,)."""
    return np.asarray(np.einsum("ni,nij,nj->n", off, W, off))


def _root(W: Array) -> Array:
    """Symmetric square roots of positive semidefinite matrices, (*b, d, d)."""
    w, Q = np.linalg.eigh(W)
    return np.asarray((Q * np.sqrt(np.maximum(w, 0.0))[..., None, :]) @ Q.mT)
