"""The gap: how far predictions are off, in which phases and channels, and how much is left with effects in."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from tossid.diagnosis.findings import Gap, Interval, Share
from tossid.diagnosis.likelihood.density import student_deviance
from tossid.diagnosis.likelihood.evidence import Evidence
from tossid.diagnosis.likelihood.whitening import linearise
from tossid.diagnosis.likelihood.windows import make_windows
from tossid.diagnosis.localisation.noise import Floor
from tossid.diagnosis.selection.cross_validation import Candidate, CrossValidator
from tossid.types import Phase, Toss

Array = NDArray[np.float64]

PHASES = (Phase.FLIGHT, Phase.IMPACT, Phase.SLIDE, Phase.ROLL, Phase.REST)
CHANNELS = ("p_x", "p_y", "p_z", "r_x", "r_y", "r_z")
"""Of the base; those of joints are joint_1 and so on."""


def deviance(evidence: Evidence, residuals: Array) -> Array:
    """(W, L, K) Student's deviance of whitened residuals in the consecutive windows; 0 outside them.

    Args:
        evidence: Of W windows.
        residuals: (W, L, K) whitened.
    """
    return np.where(evidence.windows.counted[..., None], student_deviance(residuals, evidence.density), 0.0)


def by_toss(evidence: Evidence, values: Array, n: int) -> Array:
    """(n,) sums over each toss's windows.

    Args:
        evidence: Of W windows.
        values: (W, ...).
        n: How many tosses.
    """
    sums = np.bincount(evidence.windows.toss, weights=values.reshape(len(values), -1).sum(1), minlength=n)
    return sums.astype(float)


def bootstrap_ratio(above: Array, below: Array, *, seed: int = 0, resamples: int = 500) -> Interval:
    """sum(above) / sum(below) with its percentile interval over tosses.

    Args:
        above: (n,), one a toss.
        below: (n,), likewise.
        seed: Of the resamples.
        resamples: How many.
    """
    rng = np.random.default_rng(seed)
    n = len(above)
    index = rng.integers(0, n, (resamples, n))
    bottom = below[index].sum(1)
    ratio = above[index].sum(1) / np.where(np.abs(bottom) > 1e-9, bottom, 1e-9)
    low, high = np.percentile(ratio, [2.5, 97.5])
    total = below.sum()
    return Interval(float(above.sum() / (total if abs(total) > 1e-9 else 1e-9)), float(low), float(high))


def measure_gap(tosses: Sequence[Toss], state: Candidate, validator: CrossValidator, floor: Floor) -> Gap:
    """The gap of a hypothesis: its size, and its shares by phase, channel and length of prediction.

    Args:
        tosses: As recorded.
        state: The hypothesis, judged if it has effects.
        validator: Of all windows.
        floor: The noise floor.
    """
    n, e, residuals = validator.n, state.evidence, judged_residuals(state)
    w, settings = e.windows, validator.settings
    resamples = settings.localisation.resamples
    squares, entries = _counted_squares(e, residuals)
    per_toss, count = by_toss(e, squares, n), by_toss(e, entries, n)
    ratio = bootstrap_ratio(per_toss, count, resamples=resamples)
    total = Interval(*(float(np.sqrt(max(x, 0.0))) for x in (ratio.value, ratio.low, ratio.high)))
    excess = deviance(e, residuals) - floor.deviance
    whole = by_toss(e, excess, n)

    def share(name: str, part: Array) -> Share:
        return Share(name, bootstrap_ratio(by_toss(e, part, n), whole, resamples=resamples))

    phases = tuple(share(phase.name.lower(), np.where((w.phase == phase)[..., None], excess, 0.0)) for phase in PHASES)
    channels = tuple(share(name, excess[..., c]) for c, name in enumerate(channels_of(residuals.shape[-1])))
    toss = np.broadcast_to(w.toss[:, None], w.tick.shape)
    rows = np.stack([toss, w.tick * w.dt, w.phase, excess.mean(-1)], axis=-1)[w.counted]
    mean = per_toss / np.maximum(count, 1)
    middle = np.median(mean)
    far = middle + 8 * np.median(np.abs(mean - middle)) + 1.0
    odd = tuple(toss.name for toss, size in zip(tosses, mean, strict=True) if size > far)
    own, others = settings.likelihood.windows.length, settings.localisation.other_lengths
    of_others = validator.map(lambda length: _rms_of(tosses, length, state, validator), others)
    rms = {own: total.value} | dict(zip(others, of_others, strict=True))
    lengths = tuple((length, rms[length], floor.rms) for length in sorted(rms))
    impact = w.phase == Phase.IMPACT
    followed = np.logical_or.accumulate(impact & w.inside, axis=1) & ~impact
    after = share("after_impacts", np.where(followed[..., None], excess, 0.0))
    return Gap(total, floor.rms, phases, channels, lengths, rows, odd, after)


def in_short(state: Candidate) -> str:
    """The size of a hypothesis's gap, and the phase and channel that have most of it, in a few words.

    Args:
        state: The hypothesis.
    """
    e = state.evidence
    squares, entries = _counted_squares(e, judged_residuals(state))
    rms, above = float(np.sqrt(squares.sum() / max(entries.sum(), 1.0))), squares - entries
    phase = max(PHASES, key=lambda each: float(above[e.windows.phase == each].sum()))
    channel = channels_of(above.shape[-1])[int(above.sum((0, 1)).argmax())]
    return f"the gap is {rms:.1f} standard deviations, most in {phase.name.lower()} and {channel}"


def channels_of(count: int) -> tuple[str, ...]:
    """Names of channels.

    Args:
        count: How many: 6, and one a joint.
    """
    return CHANNELS + tuple(f"joint_{k + 1}" for k in range(count - len(CHANNELS)))


def _counted_squares(evidence: Evidence, residuals: Array) -> tuple[Array, Array]:
    """(W, L, K) limited squares of whitened residuals, and 1, in consecutive windows; 0 outside them."""
    counted = evidence.windows.counted[..., None]
    squares = np.minimum(residuals**2, evidence.density.largest_residual**2)
    return np.where(counted, squares, 0.0), np.where(counted, np.ones_like(residuals), 0.0)


def _rms_of(tosses: Sequence[Toss], length: int, state: Candidate, validator: CrossValidator) -> float:
    """Root mean square of whitened residuals in windows of so many frames."""
    world, model, settings = state.hypothesis.world(), state.hypothesis.base.object, validator.settings.likelihood
    windows = make_windows(tosses, model, settings=settings, length=length, long=0, flights=False)
    # of short windows some are enough
    windows = windows.rows(np.arange(0, len(windows.toss), max(1, settings.windows.length // length)))
    kept, whitening = linearise(windows, world, n_threads=validator.n_threads)
    evidence = Evidence(kept, whitening, validator.n_threads)
    evidence = validator.with_engine_difference(evidence, state.hypothesis, restarts=0)
    return limited_rms(evidence, evidence.residuals(world)[evidence.windows.inside])


def limited_rms(evidence: Evidence, residuals: Array) -> float:
    """Root mean square of residuals, none of which counts more than the largest that the density allows.

    Args:
        evidence: Whose residuals they are.
        residuals: Whitened.
    """
    return float(np.sqrt(np.minimum(residuals**2, evidence.density.largest_residual**2).mean()))


def share_left(
    first: Candidate, last: Candidate, validator: CrossValidator, floor: Floor
) -> tuple[Interval, tuple[Share, ...]]:
    """The share of the first gap that is closed, and phases with some left; each toss at the other folds' values.

    What is left below the noise floor is all closed. So where the first gap lies below the floor too, as that of a
    small effect can, its share is taken above what is left.

    Args:
        first: The hypothesis without effects.
        last: The hypothesis with effects.
        validator: Of all windows.
        floor: The noise floor.
    """
    n, settings = validator.n, validator.settings.localisation
    before = deviance(first.evidence, first.fitted.residuals) - floor.deviance
    after = deviance(last.evidence, cross_fitted(last, validator)) - floor.deviance
    whole, rest = by_toss(first.evidence, before, n), by_toss(last.evidence, after, n)
    if not whole.sum() > 0:
        rows = by_toss(last.evidence, last.evidence.windows.counted.astype(float), n)
        below = float(rest.sum()) / max(float(rows.sum()), 1.0) * rows
        whole, rest = whole - below, rest - below
    if not whole.sum() > 0:
        return Interval(0.0, 0.0, 0.0), ()
    closed = bootstrap_ratio(whole - rest, whole, resamples=settings.resamples)
    # below the floor is no more than all
    closed = Interval(*(min(1.0, x) for x in (closed.value, closed.low, closed.high)))
    left = []
    for phase in PHASES:
        there = np.where((last.evidence.windows.phase == phase)[..., None], after, 0.0)
        share = bootstrap_ratio(by_toss(last.evidence, there, n), whole, resamples=settings.resamples)
        if share.low > 0 and share.value > settings.least_left:
            left.append(Share(phase.name.lower(), share))
    return closed, tuple(left)


def cross_fitted(state: Candidate, validator: CrossValidator) -> Array:
    """(W, L, K) whitened residuals of every toss without which the hypothesis was chosen and fitted.

    A hypothesis on the way, which was not judged so, has its values moved by one Gauss-Newton step only.

    Args:
        state: The hypothesis.
        validator: Of all windows.
    """
    fitted, e = state.fitted, state.evidence
    if not fitted.hypothesis.effects or state.judged is not None:
        return judged_residuals(state)
    out = fitted.residuals.copy()
    for held in validator.folds:
        rows = np.flatnonzero(held[e.windows.toss])
        out[rows] = e.residuals(fitted.of_part(~held).world(), rows)
    return out


def judged_residuals(state: Candidate) -> Array:
    """(W, L, K) whitened residuals as judged, or as fitted where nothing was judged.

    Args:
        state: The hypothesis.
    """
    return state.fitted.residuals if state.judged is None else state.judged


def mean_square(state: Candidate, validator: CrossValidator) -> Interval:
    """Mean square of whitened residuals, each toss at values fitted to the other folds.

    Args:
        state: The hypothesis.
        validator: Of all windows.
    """
    squares, count = _counted_squares(state.evidence, cross_fitted(state, validator))
    sums = (by_toss(state.evidence, each, validator.n) for each in (squares, count))
    return bootstrap_ratio(*sums, resamples=validator.settings.localisation.resamples)
