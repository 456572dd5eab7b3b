"""Screening: what an effect gains by one measured Gauss-Newton step, from its nominal values or a declared start."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from tossid.diagnosis.likelihood.derivatives import effect_derivatives
from tossid.diagnosis.likelihood.evidence import Evidence, Hypothesis
from tossid.diagnosis.likelihood.fitting import toss_sums
from tossid.diagnosis.selection.cross_validation import Candidate, CrossValidator
from tossid.physics.effects import Effect
from tossid.types import Phase

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Screened:
    """What a step toward an effect gains.

    Attributes:
        gain: Of log-likelihood.
        effect: The effect.
        start: The hypothesis with the effect, after the step.
        from_start: Whether the step was taken from one of the effect's declared starts, far from its nominal values.
    """

    gain: float
    effect: Effect
    start: Hypothesis
    from_start: bool = False

    def evidence(self, present: Candidate) -> Evidence:
        """Evidence around which to fit from here: the present one, restarted where this is far from it.

        Args:
            present: The hypothesis without the effect.
        """
        if not self.from_start:
            return present.evidence
        return present.evidence.relinearised(self.start.world(), refine=4, restarts=1)


@dataclass(frozen=True)
class _Start:
    """A start of the effect, the evidence there, and its gain.

    before: (W,) the present hypothesis's log-likelihoods in the same windows, over which is gained.
    """

    hypothesis: Hypothesis
    evidence: Evidence
    before: Array
    gain: float


def screen(validator: CrossValidator, present: Candidate, effect: Effect) -> Screened:
    """The gain of a Gauss-Newton step or a part of it, from the effect's nominal values or from its best start.

    Log-likelihoods are taken at first states that suit the present hypothesis or the start, whichever are better.
    Starts are far from the present hypothesis, and are tried with some of the tosses only. The best is chosen at
    first states near the present ones, which favours what is near. If it gains there, starts farther out and values
    halfway to the next ones are tried at first states of their own: where no hypothesis fits, likelihoods are rough,
    and no fit goes far.

    Args:
        validator: With its folds.
        present: The hypothesis without the effect.
        effect: What is screened.
    """
    now, whole = present.fitted, present.evidence
    nominal = now.hypothesis.plus(effect)
    base = whole.log_likelihood(now.residuals, now.scales)
    best = _step(validator, now.scales, _Start(present.hypothesis, whole, base, 0.0), effect)
    if not effect.starts:
        return best
    some = validator.screening
    share, part = float(some.mean()), whole.of_tosses(some)
    base = base[some[whole.windows.toss]]
    starts = [_at_start(nominal, effect, start) for start in effect.starts]

    def roughly(hypothesis: Hypothesis) -> _Start:
        e = part.relinearised(hypothesis.world(), refine=2, update=False)
        gain = _gain(e.gains(e.log_likelihood_of(hypothesis.world(), now.scales), base), e)
        return _Start(hypothesis, e, base, gain)

    def gained(hypothesis: Hypothesis, e: Evidence) -> tuple[Array, Array]:
        before = np.maximum(base, e.log_likelihood_of(now.hypothesis.world(), now.scales))
        after = np.maximum(*(each.log_likelihood_of(hypothesis.world(), now.scales) for each in (part, e)))
        return e.gains(after, before), before

    def with_own_states(hypothesis: Hypothesis, near: Evidence) -> _Start | None:
        e = near.relinearised(hypothesis.world(), refine=4, update=False)
        if gained(hypothesis, e)[0].sum() < -validator.settings.selection.hopeless:
            return None  # windows that are restarted make up for less
        e = e.relinearised(hypothesis.world(), refine=0, restarts=1)
        gain, before = gained(hypothesis, e)
        return _Start(hypothesis, e, before, _gain(gain, e))

    nearest = max((roughly(each) for each in starts), key=lambda each: each.gain)
    begin = with_own_states(nearest.hypothesis, nearest.evidence)
    if begin is None:
        return best
    for farther in _beyond(begin.hypothesis, starts, nominal) if begin.gain > 0 else ():
        tried = with_own_states(farther, begin.evidence)
        if tried is None or tried.gain <= begin.gain:
            break
        begin = tried
    ahead = begin.gain > share * best.gain
    for between in _beside(begin.hypothesis, starts, nominal) if ahead else ():
        tried = with_own_states(between, begin.evidence)
        if tried is not None and tried.gain > begin.gain:
            begin = tried
            break
    far = _step(validator, now.scales, begin, effect)
    return replace(far, gain=far.gain / share, from_start=True) if far.gain / share > best.gain else best


def predicted_gain(validator: CrossValidator, present: Candidate, effect: Effect) -> float:
    """What a Gauss-Newton step toward an effect would gain if predictions were linear: g^T H^-1 g / 2.

    Args:
        validator: Of all windows.
        present: The hypothesis without the effect.
        effect: The effect.
    """
    e, now = present.evidence, present.fitted
    _, own, J = effect_derivatives(e, present.hypothesis, effect, now.residuals)
    H, g = (each.sum(0) for each in toss_sums(e, now.residuals, J, now.scales, validator.n))
    gain = 0.5 * float(g @ np.linalg.pinv(H + 1e-9 * np.trace(H) * np.eye(len(own))) @ g)
    return gain / e.windows.settings.windows.flight_weight if Phase.FLIGHT in effect.phases else gain


def _at_start(nominal: Hypothesis, effect: Effect, start: Mapping[str, float]) -> Hypothesis:
    """The hypothesis with the effect, the last one, at a declared start, and in flight as it was."""
    values = {**effect.named(nominal.values[-1]), **start}
    last = np.array([values[p.name] for p in effect.parameters])
    others = [
        value * last[0] / nominal.values[-1][0] if each.in_flight_over == effect.name else value
        for each, value in zip(nominal.effects[:-1], nominal.values[:-1], strict=True)
    ]
    return replace(nominal, values=(*others, last))


def _beyond(start: Hypothesis, starts: Sequence[Hypothesis], nominal: Hypothesis) -> list[Hypothesis]:
    """Those of an effect's starts that are farther from nominal than one of them, on its side, nearest first.

    None where the effect has several parameters, whose starts have no order.
    """
    if len(start.values[-1]) > 1:
        return []
    here = _distance(start, nominal)
    beyond = (each for each in starts if _distance(each, nominal) * np.sign(here) > abs(here))
    return sorted(beyond, key=lambda each: abs(_distance(each, nominal)))


def _beside(start: Hypothesis, starts: Sequence[Hypothesis], nominal: Hypothesis) -> list[Hypothesis]:
    """Halfway from one of an effect's starts to the next one beyond it, and to the next one nearer to nominal.

    None where the effect has several parameters.
    """
    if len(start.values[-1]) > 1:
        return []
    here = _distance(start, nominal)
    nearer = [each for each in (nominal, *starts) if 0 <= _distance(each, nominal) * np.sign(here) < abs(here)]
    neighbours = [*_beyond(start, starts, nominal)[:1], max(nearer, key=lambda each: abs(_distance(each, nominal)))]
    return [start.at(0.5 * (start.flat() + each.flat())) for each in neighbours]


def _distance(each: Hypothesis, nominal: Hypothesis) -> float:
    """How far the one parameter of an effect, the last one, is from its nominal value."""
    return float((each.values[-1] - nominal.values[-1])[0])


def _step(validator: CrossValidator, scales: Array, begin: _Start, effect: Effect) -> Screened:
    """An effect after the best part of a Gauss-Newton step of its own parameters."""
    e, residuals = begin.evidence, begin.evidence.residuals(begin.hypothesis.world())
    hypothesis, own, J = effect_derivatives(e, begin.hypothesis, effect, residuals)
    best = Screened(max(begin.gain, 0.0), effect, hypothesis)
    size = len(hypothesis.flat())
    if effect.near_nothing:
        residuals = e.residuals(hypothesis.world())
    H, g = (each.sum(0) for each in toss_sums(e, residuals, J, scales, validator.n))
    delta = np.zeros(size)
    delta[own] = -np.linalg.pinv(H + 1e-9 * np.trace(H) * np.eye(len(own))) @ g
    for share in validator.settings.selection.step_shares:
        moved = hypothesis.clipped(hypothesis.flat() + share * delta * hypothesis.steps)
        gain = _gain(e.gains(e.log_likelihood_of(moved.world(), scales), begin.before), e)
        if gain > best.gain:
            best = Screened(gain, effect, moved)
        elif best.start is not hypothesis:
            break  # a larger part of the step gained more
    return best


def _gain(gain: Array, e: Evidence) -> float:
    """The gain of windows (W,), weighted in units of a flight's, or unweighted where contact gains more."""
    weight = e.windows.settings.windows.flight_weight
    return max(float(gain.sum()), float(gain @ e.windows.weights) / weight)
