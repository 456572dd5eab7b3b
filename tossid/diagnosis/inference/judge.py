"""The judge: the whole search is repeated without a part of the tosses, and judged by that part (cross-fitting).

What was chosen, and every value, comes from tosses that are not judged. So a share of the gap that was closed, and how
often each effect is named, hold for further tosses of the same kind (Chernozhukov et al., Econometrics Journal 2018).
Nothing is shared between folds. The windows of judged tosses have a tracker's slow errors as the others show them.

How often an effect is named comes from tosses drawn with replacement, in each fold's own search. In a draw an effect
stays if the drawn tosses still need it, and make nothing that could take its place clearly likelier: the search's own
rule (`alternatives.stands`). That is a sum of known gains, and costs no simulation.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.stats import bootstrap

from tossid.diagnosis.findings import RESAMPLES, Interval
from tossid.diagnosis.inference.evidence import Evidence
from tossid.diagnosis.inference.found import Found
from tossid.diagnosis.inference.hypothesis import Hypothesis
from tossid.diagnosis.inference.sample import LEAST_GAIN, Sample, margin
from tossid.diagnosis.inference.search import Search
from tossid.diagnosis.likelihood.density import student_deviance
from tossid.diagnosis.likelihood.windows import Windows
from tossid.parallel import in_threads

Array = NDArray[np.float64]
Index = NDArray[np.int64]

DRAWS = 200
"""Of tosses with replacement, in each fold."""


@dataclass(frozen=True)
class Fold:
    """One part of the tosses, and what was found without it.

    Attributes:
        held: Numbers of the tosses that are judged.
        found: By the search over the others.
        before: Evidence of the judged tosses, with the simulator as it is stated.
        after: The same with what was found.
        without: The same without each effect, by its name; empty where nothing asks for it.
    """

    held: Index
    found: Found
    before: Evidence
    after: Evidence
    without: Mapping[str, Evidence]


def judged_by(held: Index, sample: Sample, stated: Hypothesis, found: Found) -> Fold:
    """Tosses that judge what was found without them.

    Args:
        held: Their numbers.
        sample: Of these tosses.
        stated: The simulator as it is stated.
        found: What the search over the others has found.
    """
    return Fold(held, found, sample.evidence(stated), sample.evidence(found.hypothesis), {})


def with_each_left_out(fold: Fold) -> Fold:
    """A fold with the evidence of its tosses without each effect that was found.

    Args:
        fold: Of `judged_by`.
    """
    h = fold.found.hypothesis
    return replace(fold, without={name: fold.after.relinearised(h.without(name), steps=3) for name in h.names})


def cross_fit(
    search_of: Callable[[Index], Search],
    windows_of: Callable[[Index, Index], Windows],
    *,
    n: int,
    count: int,
    seed: int = 0,
    n_threads: int = 1,
) -> Iterator[Fold]:
    """Folds of the tosses, each judging what the others find.

    Args:
        search_of: The search over some tosses.
        windows_of: The windows of tosses (the first numbers), with slow errors as other tosses (the second) show them.
        n: How many tosses.
        count: Of folds.
        seed: Of the division.
        n_threads: Folds at once.
    """
    place = np.random.default_rng(seed).permutation(n) % min(count, n)

    def fold(k: int) -> Fold:
        held, others = np.flatnonzero(place == k), np.flatnonzero(place != k)
        search = search_of(others)
        sample = Sample(windows_of(held, others), len(held), search.sample.n_threads)
        return with_each_left_out(judged_by(held, sample, search.stated, search.run()))

    yield from in_threads(fold, range(min(count, n)), n_threads)


@dataclass(frozen=True)
class Frequencies:
    """How often effects are named by searches over resampled tosses.

    Attributes:
        names: P names of effects.
        drawn: (draws, P) which of them each search names.
    """

    names: tuple[str, ...]
    drawn: NDArray[np.bool_]

    @property
    def none(self) -> float:
        """Share of the searches that name nothing."""
        return float((~self.drawn.any(1)).mean())

    def of_any(self, names: Collection[str]) -> float:
        """Share of the searches that name any of some effects.

        Args:
            names: Of the effects.
        """
        return float(self.drawn[:, [each in names for each in self.names]].any(1).mean())


def frequencies(folds: Sequence[Fold], *, seed: int = 0) -> Frequencies:
    """How often each effect is named by searches over resampled tosses of the other folds.

    Args:
        folds: Of `cross_fit`.
        seed: Of the draws.
    """
    rng = np.random.default_rng(seed)
    found = [fold.found for fold in folds]
    names = tuple(dict.fromkeys([*(n for f in found for n in f.needed), *(n for f in found for n in f.rival_names)]))
    named = np.zeros((len(folds), DRAWS, len(names)), dtype=bool)
    for each, out in zip(found, named, strict=True):
        drawn = rng.integers(0, each.fit.n, (DRAWS, each.fit.n))
        for name, gain in each.needed.items():
            kept = gain[drawn].sum(1) > LEAST_GAIN
            for rival in each.rivals.get(name, ()):
                ahead = kept & (rival.gain[drawn].sum(1) > margin(rival.gain))
                out[:, names.index(rival.effect.name)] |= ahead
                kept = kept & ~ahead
            out[:, names.index(name)] |= kept
    return Frequencies(names, named.reshape(len(folds) * DRAWS, len(names)))


def closed_share(folds: Sequence[Fold], floor: Array) -> Interval:
    """The share of the gap above noise that is closed, with its percentile interval over tosses.

    The gap is -2 log likelihood with scales of one. It has the log determinants of the whitening: a hypothesis whose
    predictions are less certain leaves smaller residuals of the same motions, and closes nothing by that.

    Args:
        folds: Of `cross_fit`.
        floor: (K,) expected deviance of noise alone in each channel.
    """
    before = _of_all([fold.before for fold in folds], folds, floor)
    return _share(before, _of_all([fold.after for fold in folds], folds, floor))


def lost_without(folds: Sequence[Fold], name: str, floor: Array) -> Interval:
    """The share of the gap above noise that is lost without one effect, the others at their values.

    Args:
        folds: Of `cross_fit`.
        name: Of the effect. A fold that has not found it loses nothing.
        floor: (K,) expected deviance of noise alone in each channel.
    """
    before, after, without = (
        _of_all(each, folds, floor)
        for each in (
            [fold.before for fold in folds],
            [fold.after for fold in folds],
            [fold.without.get(name, fold.after) for fold in folds],
        )
    )
    return _share(before, before - (without - after))


def _of_all(evidences: Sequence[Evidence], folds: Sequence[Fold], floor: Array) -> Array:
    """(n,) deviance above noise of the judged tosses, in the order of the folds."""
    pairs = zip(evidences, folds, strict=True)
    return np.concatenate([_deviance_of_tosses(each, floor, fold.after) for each, fold in pairs])


def _share(before: Array, after: Array) -> Interval:
    """1 - after / before of sums over tosses, with its percentile interval; from -1 to 1."""
    if not before.sum() > 0:
        return Interval(0.0, 0.0, 0.0)

    def share(before: Array, after: Array, axis: int = -1) -> Array:
        total = before.sum(axis)
        return np.asarray(1.0 - after.sum(axis) / np.where(np.abs(total) > 0, total, 1.0))

    drawn = bootstrap(
        (before, after), share, paired=True, vectorized=True, n_resamples=RESAMPLES, method="percentile",
        rng=np.random.default_rng(0),
    )  # fmt: skip
    ends = (float(share(before, after)), float(drawn.confidence_interval.low), float(drawn.confidence_interval.high))
    # where hardly any gap is above the noise, a share of it may be anything: below -1 it says no more than that
    return Interval(*(float(np.clip(x, -1.0, 1.0)) for x in ends))


def _deviance_of_tosses(evidence: Evidence, floor: Array, last: Evidence) -> Array:
    """(m,) deviance of each judged toss above what noise leaves at the last hypothesis's whitening."""
    w = evidence.windows
    counted = w.counted[..., None]
    excess = np.where(counted, student_deviance(evidence.residuals, evidence.density) - floor, 0.0).sum((1, 2))
    # (a window of flight repeats frames that others have)
    excess += np.where(w.free, 0.0, 2 * (last.whitening.log_det - evidence.whitening.log_det))
    toss = np.unique(w.toss, return_inverse=True)[1]
    return np.bincount(toss, weights=excess).astype(float)
