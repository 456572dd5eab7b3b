"""What an effect promises beside a hypothesis: the gain of one measured step, from nothing or from afar."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from tossid.diagnosis.evidence import Evidence, Hypothesis, gains
from tossid.diagnosis.fitting import derivatives, toss_sums
from tossid.diagnosis.judging import Candidate, Judge
from tossid.diagnosis.windows import FLIGHT_WEIGHT
from tossid.physics.effects import Effect

Array = NDArray[np.float64]

SCREENING = 3
"""Folds whose tosses screen what is far."""
STEP_SHARES = (1.0, 0.3, 0.1, 0.03)
"""Parts of a screening step that are tried: impacts are far from linear."""


@dataclass(frozen=True)
class Screened:
    """Gain of an effect's step, the values there, and whether it was taken from a start far from nothing."""

    gain: float
    effect: Effect
    start: Hypothesis
    far: bool = False

    def evidence(self, present: Candidate) -> Evidence:
        """Around which to fit from here: that of the present hypothesis, begun anew if this is far from it."""
        return present.evidence.renewed(self.start.world(), refine=4, restarts=1) if self.far else present.evidence


def screened(judge: Judge, present: Candidate, effect: Effect) -> Screened:
    """The gain of a step of Gauss-Newton or a part of it, from nothing or from the best start.

    First states are as they are for the present hypothesis, or as they are for a start, whichever suit: starts
    are far from it, and are tried with some of the tosses. The best is found with first states near the present ones,
    which favours what is near; from there, starts farther out are tried with first states of their own.
    """
    now, whole = present.fitted, present.evidence
    nothing = now.hypothesis.plus(effect)
    base = whole.log_likelihood(now.residual, now.scales)
    best = _stepped(judge, present, nothing, whole, base, 0.0)
    if not effect.starts:
        return best
    some = np.any(judge.folds[:SCREENING], axis=0)
    share, e0 = float(some.mean()), whole.of_tosses(some)
    base = base[some[whole.windows.toss]]

    def ll(e: Evidence, hypothesis: Hypothesis) -> Array:
        return e.log_likelihood(e.residual(hypothesis.world()), now.scales)

    here = effect.named(nothing.values[-1])
    tried = []
    for start in effect.starts:
        values = {**here, **start}
        hypothesis = now.hypothesis.plus(effect, np.array([values[p.name] for p in effect.parameters]))
        e = e0.renewed(hypothesis.world(), refine=2, anew=False)
        tried.append((_gain(gains(ll(e, hypothesis), base), e), hypothesis, e))

    def begun(hypothesis: Hypothesis, near: Evidence) -> tuple[float, Array, Evidence]:
        e = near.renewed(hypothesis.world(), refine=4, restarts=1)
        before = np.maximum(base, ll(e, now.hypothesis))
        return _gain(gains(np.maximum(ll(e0, hypothesis), ll(e, hypothesis)), before), e), before, e

    _, hypothesis, e = max(tried, key=lambda each: each[0])
    begin, before, e = begun(hypothesis, e)
    for farther in _beyond(hypothesis, [each[1] for each in tried], nothing):
        promised = begun(farther, e)
        if promised[0] <= begin:
            break
        hypothesis, (begin, before, e) = farther, promised
    far = _stepped(judge, present, hypothesis, e, before, begin)
    return replace(far, gain=far.gain / share, far=True) if far.gain / share > best.gain else best


def _beyond(start: Hypothesis, starts: list[Hypothesis], nothing: Hypothesis) -> list[Hypothesis]:
    """Those of an effect's starts that are farther from nothing than one of them, on its side, nearest first.

    None where the effect has several parameters, whose starts have no order.
    """
    if len(start.values[-1]) > 1:
        return []

    def away(each: Hypothesis) -> float:
        return float((each.values[-1] - nothing.values[-1])[0])

    here = away(start)
    return sorted((each for each in starts if away(each) * np.sign(here) > abs(here)), key=lambda each: abs(away(each)))


def _stepped(
    judge: Judge, present: Candidate, hypothesis: Hypothesis, e: Evidence, before: Array, begin: float
) -> Screened:
    """The last effect of a hypothesis after the best part of a step of Gauss-Newton.

    Args:
        before: (W,) log-likelihoods of the present hypothesis; begin: gain over them without a step.
    """
    effect, scales = hypothesis.effects[-1], present.fitted.scales
    best = Screened(max(begin, 0.0), effect, hypothesis)
    size = len(hypothesis.flat())
    own = list(range(size - len(effect.parameters), size))
    residual = e.residual(hypothesis.world())
    J = derivatives(e, hypothesis, residual, own)[..., own]
    H, g = (each.sum(0) for each in toss_sums(e, residual, J, scales, judge.n))
    delta = np.zeros(size)
    delta[own] = -np.linalg.pinv(H + 1e-9 * np.trace(H) * np.eye(len(own))) @ g
    low, high = hypothesis.bounds
    for share in STEP_SHARES:
        moved = hypothesis.at(np.clip(hypothesis.flat() + share * delta * hypothesis.steps, low, high))
        gained = _gain(gains(e.log_likelihood(e.residual(moved.world()), scales), before), e)
        if gained > best.gain:
            best = Screened(gained, effect, moved)
        elif gained > begin:
            break
    return best


def _gain(gain: Array, e: Evidence) -> float:
    """Of windows (W,), by their weights, or by their number where contact shows more."""
    return max(float(gain.sum()), float(gain @ e.windows.weights) / FLIGHT_WEIGHT)
