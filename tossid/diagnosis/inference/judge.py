"""The judge: the whole search is repeated without a part of the tosses, and judged by that part (cross-fitting).

What was chosen, and every value, comes from tosses that are not judged. So a share of the gap that was closed, and how
often each effect is named, hold for further tosses of the same kind (Chernozhukov et al., Econometrics Journal 2018).
Nothing is shared between folds but the evidence of the simulator as it is stated, for which nothing was fitted.

How often an effect is named comes from tosses drawn with replacement, in each fold's own search. In a draw an effect
stays if the drawn tosses still need it, and prefer it to what could take its place. That is a sum of known gains, and
costs no simulation.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import bootstrap

from tossid.diagnosis.findings import Interval
from tossid.diagnosis.inference.evidence import Evidence, collect
from tossid.diagnosis.inference.found import Found
from tossid.diagnosis.inference.search import LEAST_GAIN, Search
from tossid.diagnosis.likelihood.density import student_deviance
from tossid.parallel import in_threads

Array = NDArray[np.float64]
Index = NDArray[np.int64]

DRAWS = 200
"""Of tosses with replacement, in each fold."""
RESAMPLES = 500
"""Of tosses, for the interval of a share."""


@dataclass(frozen=True)
class Fold:
    """One part of the tosses, and what was found without it.

    Attributes:
        held: Numbers of the tosses that are judged.
        found: By the search over the others.
        before: Evidence of the judged tosses, with the simulator as it is stated.
        after: The same with what was found.
    """

    held: Index
    found: Found
    before: Evidence
    after: Evidence


def cross_fit(
    search_of: Callable[[Index], tuple[Search, Evidence | None]],
    first: Evidence,
    *,
    n: int,
    count: int,
    seed: int = 0,
    n_threads: int = 1,
) -> list[Fold]:
    """Folds of the tosses, each judging what the others find.

    Args:
        search_of: The search over some tosses, and their evidence without effects if it is known.
        first: Evidence of all tosses, with the simulator as it is stated.
        n: How many tosses.
        count: Of folds.
        seed: Of the division.
        n_threads: Folds at once.
    """
    place = np.random.default_rng(seed).permutation(n) % min(count, n)

    def fold(k: int) -> Fold:
        held, others = np.flatnonzero(place == k), np.flatnonzero(place != k)
        search, known = search_of(others)
        found = search.run(known)
        before = after = first.of_tosses(held)
        if found.hypothesis.effects or found.hypothesis.law != search.stated.law:
            after = collect(before.windows, found.hypothesis, n_threads=search.sample.n_threads)
        return Fold(held, found, before, after)

    return list(in_threads(fold, range(min(count, n)), n_threads))


def frequencies(folds: Sequence[Fold], *, seed: int = 0) -> dict[str, float]:
    """How often each effect is named by searches over resampled tosses of the other folds.

    Args:
        folds: Of `cross_fit`.
        seed: Of the draws.
    """
    rng, out = np.random.default_rng(seed), dict[str, float]()
    for fold in folds:
        for name, gain in fold.found.needed.items():
            drawn = rng.integers(0, len(gain), (DRAWS, len(gain)))
            kept = gain[drawn].sum(1) > LEAST_GAIN
            for rival in fold.found.rivals.get(name, ()):
                ahead = kept & (rival.gain[drawn].sum(1) > 0)
                out[rival.effect.name] = out.get(rival.effect.name, 0.0) + float(ahead.mean()) / len(folds)
                kept = kept & ~ahead
            out[name] = out.get(name, 0.0) + float(kept.mean()) / len(folds)
    return out


def closed_share(folds: Sequence[Fold], floor: Array) -> Interval:
    """The share of the gap above noise that is closed, with its percentile interval over tosses.

    The gap is -2 log likelihood with scales of one. It has the log determinants of the whitening: a hypothesis whose
    predictions are less certain leaves smaller residuals of the same motions, and closes nothing by that.

    Args:
        folds: Of `cross_fit`.
        floor: (K,) expected deviance of noise alone in each channel.
    """
    before, after = np.zeros(0), np.zeros(0)
    for fold in folds:
        deviances = [_deviance_of_tosses(e, floor, fold.after) for e in (fold.before, fold.after)]
        before, after = np.append(before, deviances[0]), np.append(after, deviances[1])
    whole = before.sum()
    if not whole > 0:
        return Interval(0.0, 0.0, 0.0)

    def share(before: Array, after: Array, axis: int = -1) -> Array:
        total = before.sum(axis)
        return np.asarray(1.0 - after.sum(axis) / np.where(np.abs(total) > 0, total, 1.0))

    drawn = bootstrap(
        (before, after), share, paired=True, vectorized=True, n_resamples=RESAMPLES, method="percentile",
        rng=np.random.default_rng(0),
    )  # fmt: skip
    ends = (float(share(before, after)), float(drawn.confidence_interval.low), float(drawn.confidence_interval.high))
    return Interval(*(min(1.0, x) for x in ends))


def _deviance_of_tosses(evidence: Evidence, floor: Array, last: Evidence) -> Array:
    """(m,) deviance of each judged toss above what noise leaves at the last hypothesis's whitening."""
    w = evidence.windows
    counted = w.counted[..., None]
    excess = np.where(counted, student_deviance(evidence.residuals, evidence.density) - floor, 0.0).sum((1, 2))
    # (a window of flight repeats frames that others have)
    excess += np.where(w.free, 0.0, 2 * (last.whitening.log_det - evidence.whitening.log_det))
    toss = np.unique(w.toss, return_inverse=True)[1]
    return np.bincount(toss, weights=excess).astype(float)
