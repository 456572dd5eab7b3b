"""Changes over an order, tested by permutation.

Each item i has a vector y_i with information A_i (the inverse covariance of its own error; 0 where it says nothing).
With scatter tau between items, its weight is W_i = A_i (1 + tau² A_i)^-1. About the robust mean c of all items, the
scores

    g_i = u_i W_i^1/2 (y_i - c),      u_i = min(1, outlier / |W_i^1/2 (y_i - c)|)

are of one size in all items: none counts more than another, however much it says of itself. (With W_i for W_i^1/2, the
score of a Gaussian likelihood, items that say little by that change are outweighed by the others.) Where the first k
of n items differ from the others, so do their scores: the statistic of a split is

    T_k = n / (k (n - k)) s_kᵀ V⁺ s_k,      s_k = g_1 + … + g_k,   V = Σ g_i g_iᵀ / n,

of scores about their mean, the score test of a change (Nyblom 1989). Its largest value over all splits is compared with
those of the same items in random orders (Good 2005): whatever the distribution of the items, p-values of an order that
means nothing are uniform.
Witnesses of one order are corrected for their number (Holm 1979), and parts are searched again (binary segmentation).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from math import comb

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from tossid.settings.sessions import SessionSettings

Array = NDArray[np.float64]
Witness = tuple[Array, Array, Array]
"""Values (n, d), information (n, d, d), and covariates (n, m)."""

DEFAULT = SessionSettings()
_BLOCK = 1 << 22
"""Numbers in memory while random orders are looked at."""


@dataclass(frozen=True)
class Change:
    """A change between two items in a row.

    Attributes:
        at: The first item after it.
        p: By witness that changed, the probability of such a change in an order that means nothing, corrected for the
            number of witnesses.
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
        scatter: Between items, beyond their own errors, tau.
        n: Items that say something.
    """

    value: Array
    cov: Array
    scores: Array
    scatter: float
    n: int


def robust_mean(values: Array, info: Array, *, outlier: float = DEFAULT.outlier) -> Mean:
    """The mean of items with errors of their own and scatter between them.

    Args:
        values: (n, d); NaN where the information is 0.
        info: Inverse covariances of the items' own errors, (n, d, d).
        outlier: Standard deviations beyond which an item counts no more than one at this distance.

    Returns:
        The mean; its covariance is clustered by item.
    """
    n, d = values.shape
    rank = np.linalg.matrix_rank(info, hermitian=True)
    seen = rank > 0
    if not seen.any():
        return Mean(np.full(d, np.nan), np.full((d, d), np.nan), np.zeros((n, d)), 0.0, 0)
    y, A, rank = values[seen], info[seen], rank[seen]
    eye = np.eye(d)
    center = np.median(y, axis=0)
    for _ in range(3):
        tau2 = variance_between(y - center, A, rank)
        W = A @ np.linalg.inv(eye + tau2 * A)
        for _ in range(20):
            off = y - center
            size = np.sqrt(np.maximum(np.einsum("ni,nij,nj->n", off, W, off), 1e-300))
            u = np.minimum(1.0, outlier / size)
            H = np.einsum("n,nij->ij", u, W)
            step = np.linalg.lstsq(H, np.einsum("n,nij,nj->i", u, W, off), rcond=1e-10)[0]
            center = center + step
            if np.abs(step).max() <= 1e-12 * (1 + np.abs(center).max()):
                break
    g = u[:, None] * np.einsum("nij,nj->ni", W, y - center)
    inverse = np.linalg.pinv(H, rcond=1e-10, hermitian=True)
    w, Q = np.linalg.eigh(W)
    scores = np.zeros((n, d))
    scores[seen] = u[:, None] * np.einsum("nij,nj,nkj,nk->ni", Q, np.sqrt(np.maximum(w, 0.0)), Q, y - center)
    return Mean(center, inverse @ (g.T @ g) @ inverse, scores, float(np.sqrt(tau2)), int(seen.sum()))


def variance_between(off: Array, info: Array, rank: NDArray[np.int64]) -> float:
    """The variance between items that makes the median of their squared whitened distances that of χ².

    Args:
        off: Distances of the items from what they scatter about, (n, d).
        info: Inverse covariances of the items' own errors, (n, d, d).
        rank: Of these, (n,).
    """

    def median(tau2: float) -> float:
        W = info @ np.linalg.inv(np.eye(off.shape[1]) + tau2 * info)
        return float(np.median(chi2.cdf(np.einsum("ni,nij,nj->n", off, W, off), rank)))

    high = float(np.sum(np.median(off**2, axis=0))) * 10 + 1e-30
    if median(0.0) <= 0.5 or median(high) > 0.5:
        return 0.0
    low = 0.0
    for _ in range(30):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if median(middle) > 0.5 else (low, middle)
    return high


def split_statistics(scores: Array, fewest: int) -> Array:
    """T_k of every split with enough items on both sides, (n - 2 fewest + 1,).

    Args:
        scores: Of the items in their order, (..., n, d).
        fewest: Items on each side at least.
    """
    n = scores.shape[-2]
    k = np.arange(fewest, n - fewest + 1)
    centred = scores - scores.mean(axis=-2, keepdims=True)
    first = centred.reshape(-1, *centred.shape[-2:])[0]
    root = np.linalg.pinv(first.T @ first / n, rcond=1e-10, hermitian=True)
    w, Q = np.linalg.eigh(root)
    sums = np.cumsum(centred @ (Q * np.sqrt(np.maximum(w, 0.0))), axis=-2)[..., k - 1, :]
    return np.asarray((sums**2).sum(axis=-1) * (n / (k * (n - k))))


def fewest_items(n_witnesses: int, settings: SessionSettings = DEFAULT) -> int:
    """The smallest number of items among which a change can be significant at all.

    Two halves of n items that differ by any amount are one of so many divisions of them; the probability of the order
    that was recorded cannot be less than that of one division.

    Args:
        n_witnesses: That are corrected for.
        settings: Significance and the smallest session.
    """
    n = 2 * settings.fewest_tosses
    while 2 * n / comb(n, n // 2) > settings.significance / n_witnesses:
        n += 1
    return n


def without_covariates(values: Array, info: Array, covariates: Array, *, outlier: float = DEFAULT.outlier) -> Array:
    """Values without what covariates explain by a robust linear regression: what depends on place is no change.

    Args:
        values: (n, d).
        info: Inverse covariances, (n, d, d); rows whose information is 0 are left as they are.
        covariates: (n, m); NaN counts as their mean.
        outlier: Standard deviations beyond which an item counts no more than one at this distance.
    """
    seen = np.trace(info, axis1=1, axis2=2) > 0
    m = covariates.shape[1]
    if seen.sum() < 4 * (m + 1):
        return values
    with np.errstate(invalid="ignore"):
        x = covariates - np.nanmean(covariates[seen], axis=0)
    X = np.column_stack([np.ones(int(seen.sum())), np.nan_to_num(x[seen])])
    y, weight = values[seen], np.ones(int(seen.sum()))
    for _ in range(10):
        root = np.sqrt(weight)[:, None]
        B = np.linalg.lstsq(X * root, y * root, rcond=1e-6)[0]
        off = y - X @ B
        scale = 1.4826 * np.median(np.abs(off), axis=0) + 1e-12
        weight = np.minimum(1.0, outlier / np.maximum(np.sqrt(((off / scale) ** 2).mean(axis=1)), 1e-12))
    out = values.copy()
    out[seen] = y - X[:, 1:] @ B[1:]
    return out


def find_changes(witnesses: Mapping[str, Witness], *, settings: SessionSettings = DEFAULT) -> tuple[Change, ...]:
    """Where witnesses change over the order of items.

    Args:
        witnesses: By name, values (n, d), information (n, d, d) and covariates (n, m) of the same items in their order.
        settings: Significance, the smallest session, and how many orders are drawn.

    Returns:
        The changes in their order.
    """
    rng = np.random.default_rng(settings.seed)
    n = len(next(iter(witnesses.values()))[0])
    found: list[Change] = []
    parts = [(0, n)]
    while parts:
        start, stop = parts.pop()
        part = {name: (y[start:stop], A[start:stop], x[start:stop]) for name, (y, A, x) in witnesses.items()}
        change = _change(part, settings, rng)
        if change is not None:
            at = start + change.at
            found.append(Change(at, change.p))
            parts += [(start, at), (at, stop)]
    return tuple(sorted(found, key=lambda change: change.at))


def changes_at(witnesses: Mapping[str, Witness], at: int, *, settings: SessionSettings = DEFAULT) -> dict[str, float]:
    """Which witnesses change where a change is known to be.

    No place is searched, so that less is enough than for `find_changes`. Whether anything changes is tested for all
    witnesses together, by the smallest of their p-values in the same random divisions of the items (Westfall and Young
    1993). If so, each is tested by itself.

    Args:
        witnesses: As of `find_changes`.
        at: The first item after the change.
        settings: Significance, and how many divisions are drawn.

    Returns:
        By witness, the probability of as large a change in a division that means nothing, where it is significant;
        nothing if all witnesses together are not.
    """
    n = len(next(iter(witnesses.values()))[0])
    before = np.tile(np.arange(n) < at, (settings.permutations, 1))
    before = np.random.default_rng(settings.seed).permuted(before, axis=1)
    found, least = {}, np.ones(settings.permutations + 1)
    for name, scores in _scores(witnesses, settings).items():
        centred = scores - scores.mean(axis=0)
        inverse = np.linalg.pinv(centred.T @ centred / n, rcond=1e-10, hermitian=True)
        sums = np.concatenate([centred[None, :at].sum(axis=1), before @ centred])
        sizes = np.einsum("ri,ij,rj->r", sums, inverse, sums)
        below = np.searchsorted(np.sort(sizes), sizes * (1 - 1e-9))
        p = 1 - below / len(sizes)
        least = np.minimum(least, p)
        if p[0] <= settings.significance:
            found[name] = float(p[0])
    return found if np.mean(least <= least[0]) <= settings.significance else {}


def _scores(witnesses: Mapping[str, Witness], settings: SessionSettings) -> dict[str, Array]:
    """Whitened and bounded scores of what varies, without what covariates explain."""
    scores = {}
    for name, (recorded, info, covariates) in witnesses.items():
        values = without_covariates(recorded, info, covariates, outlier=settings.outlier)
        mean = robust_mean(values, info, outlier=settings.outlier)
        # of what does not vary, no change can be seen
        if mean.n >= 2 * settings.fewest_tosses and np.ptp(values[np.isfinite(values[:, 0])], axis=0).max() > 0:
            scores[name] = mean.scores
    return scores


def _change(witnesses: Mapping[str, Witness], settings: SessionSettings, rng: np.random.Generator) -> Change | None:
    """The clearest change of a stretch, if there is one."""
    n, fewest = len(next(iter(witnesses.values()))[0]), settings.fewest_tosses
    if n < fewest_items(len(witnesses), settings):
        return None
    scores = _scores(witnesses, settings)
    if not scores:
        return None
    splits = {name: split_statistics(g, fewest) for name, g in scores.items()}
    above = dict.fromkeys(scores, 0)
    width = sum(g.shape[1] for g in scores.values())
    drawn, least = 0, settings.first_permutations
    while drawn < settings.permutations:
        # after the first orders, nothing that is far from significant is pursued (Besag and Clifford 1991)
        if drawn >= least and (1 + min(above.values())) / (1 + drawn) > 5 * settings.significance:
            return None
        count = min(least if drawn == 0 else settings.permutations - drawn, max(1, _BLOCK // (n * width)))
        orders = rng.permuted(np.tile(np.arange(n), (count, 1)), axis=1)
        for name, g in scores.items():
            above[name] += int(np.sum(split_statistics(g[orders], fewest).max(axis=-1) >= splits[name].max()))
        drawn += count
    p = {name: (1 + count) / (1 + drawn) for name, count in above.items()}
    corrected, worst = {}, 0.0
    for rank, name in enumerate(sorted(p, key=lambda name: p[name])):
        worst = max(worst, min(1.0, p[name] * (len(p) - rank)))
        corrected[name] = worst
    significant = {name: value for name, value in corrected.items() if value <= settings.significance}
    if not significant:
        return None
    total = np.sum([splits[name] for name in significant], axis=0)
    return Change(fewest + int(np.argmax(total)), significant)
