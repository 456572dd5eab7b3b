"""What a search has found, settled: looked for farther away and where tosses are cut elsewhere, less what is nothing
there; and how well each value is known."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2
from scipy.stats import t as student

from tossid.diagnosis.evidence import Hypothesis, gains
from tossid.diagnosis.findings import Interval
from tossid.diagnosis.fitting import Fitted, derivatives, toss_sums
from tossid.diagnosis.judging import Judge
from tossid.diagnosis.rounds import CLASS_LEVEL
from tossid.diagnosis.search import Found
from tossid.diagnosis.windows import FLIGHT_WEIGHT, LENGTH, make_windows
from tossid.objects import ObjectModel
from tossid.physics.effects import NEVER_NOTHING
from tossid.types import Phase, Toss

Array = NDArray[np.float64]

WALK = (0.4, 0.04)
"""Largest and smallest share of an effect by which it is moved,"""
WORTH_A_STEP = 3.0
"""and the gain of log-likelihood that is worth it."""
CUTS = ((LENGTH // 4, 1.0), (LENGTH // 2, -1.0), (3 * LENGTH // 4, 1.0))
"""Frames by which tosses are cut elsewhere, and to which side fits begin."""
ASIDE = 0.1
"""By how much fits begin elsewhere, over what a parameter differs from its nominal value,"""
ASIDE_IN_FLIGHT = 2.0
"""and, of what acts in flight, over its standard error."""


def walked(judge: Judge, found: Found) -> Found:
    """The search's result with each effect that contact has shown by one number looked for farther away.

    Contact makes the likelihood rough: a fit ends near where it began, far from where all tosses together suit an
    effect best. So its number is moved away from nothing and towards it, by less and less of what it is, wherever
    first states that are sought anew make that better.
    """
    present = found.present
    for effect in present.hypothesis.effects[found.flown :]:
        reach = WALK[0] if len(effect.parameters) == 1 else 0.0
        while reach > WALK[1]:
            for share in (1.0 + reach, 1.0 - reach):
                nothing, values = effect.nominal(present.hypothesis.base), present.hypothesis.values_of(effect.name)
                asked = present.hypothesis.with_instead(effect.name, effect, nothing + share * (values - nothing))
                there = judge.start(asked.at(np.clip(asked.flat(), *asked.bounds)))
                if judge.contest(there, present).sum() > WORTH_A_STEP:
                    present = there
                    break
            else:
                reach *= 0.5
    if present is found.present:
        return found
    return found.ending(judge.judged(present, found.present.effect, present.hypothesis))


def cut_elsewhere(tosses: Sequence[Toss], model: ObjectModel, judge: Judge, found: Found) -> tuple[Found, Array | None]:
    """The search's result at values that do not depend on where tosses are cut: medians of fits to several sets of
    windows, and their standard deviations (P,).

    Contact makes the likelihood rough, and where on it a fit ends hangs on where it began: each begins somewhere else,
    to either side of what was found. What flight has shown is near where it belongs: moved far away, it would be held
    there by first states in contact that suit it.
    """
    if not found.present.hypothesis.effects:
        return found, None
    present = found.present
    if not np.diag(present.fitted.H.sum(0)).all():
        # the search ended with what flight had shown held, which has no slopes then: here all of it may move
        present = judge.judged(present, present.effect, present.hypothesis, 0)
    flat = present.hypothesis.flat()
    nothing = np.concatenate([effect.nominal(present.hypothesis.base) for effect in present.hypothesis.effects])
    flies = [Phase.FLIGHT in effect.phases for effect in present.hypothesis.effects for _ in effect.parameters]
    error = np.sqrt(np.maximum(np.diag(present.fitted.covariance()), 0.0))
    way = np.where(flies, ASIDE_IN_FLIGHT * error, ASIDE * (flat - nothing))
    way *= np.random.default_rng(len(flat)).choice([-1.0, 1.0], len(flat))

    def fitted(cut: tuple[int, float]) -> Array:
        skip, side = cut
        other = replace(judge, windows=make_windows(tosses, model, skip=skip))
        start = present.hypothesis.at(np.clip(flat + side * way, *present.hypothesis.bounds))
        there = other.polished(other.start(start).evidence, start, 2)
        back = there.evidence.renewed(present.hypothesis.world(), refine=4)
        ll = back.log_likelihood(back.residual(present.hypothesis.world()), there.scales)
        ended = there.evidence.log_likelihood(there.residual, there.scales)
        if gains(ended, ll) @ there.evidence.windows.weights < 0:
            # it has ended in a worse place than where it was to come back to
            there = other.polished(back, present.hypothesis, 2)
        return there.hypothesis.flat()

    values = np.array([flat, *judge.each(fitted, CUTS)])
    middle = present.hypothesis.at(np.median(values, axis=0))
    settled = judge.judged(present, present.effect, middle, 0)
    if judge.better(present, settled) < CLASS_LEVEL:
        # parameters that make up for each other have medians that do not
        settled = present
    return found.ending(settled), np.std(values, axis=0, ddof=1)


def without_nothings(judge: Judge, found: Found, spread: Array | None) -> tuple[Found, Array | None]:
    """Without effects of contact whose values are not clearly other than nothing (Wald's test, 5 %), the least clear
    first: they gained something where tosses were cut first, and not elsewhere."""
    while spread is not None and (name := _nothing(judge, found, spread)):
        hypothesis = found.present.hypothesis
        own = hypothesis.place_of(name)
        found = replace(
            found.ending(judge.judged(found.present, None, hypothesis.minus(name))),
            needed={other: each for other, each in found.needed.items() if other != name},
            classes={other: group for other, group in found.classes.items() if other != name},
        )
        spread = np.delete(spread, own)
    return found, spread


def _nothing(judge: Judge, found: Found, spread: Array) -> str | None:
    """The effect that contact has shown and that is least clearly other than nothing; None if each is."""
    hypothesis = found.present.hypothesis
    cov = _covariance(found.present.fitted, judge.n, spread, found.flown)
    least, name = CLASS_LEVEL, None
    for effect in hypothesis.effects[found.flown :]:
        own = hypothesis.place_of(effect.name)
        size = np.sqrt(np.diag(cov)[own])
        away = (hypothesis.values_of(effect.name) - effect.nominal(hypothesis.base)) / size
        alike = cov[own, own] / np.outer(size, size)
        p_value = float(chi2.sf(away @ np.linalg.pinv(alike, hermitian=True) @ away, len(away)))
        if effect.name not in NEVER_NOTHING and p_value > least:
            least, name = p_value, effect.name
    return name


def intervals(fitted: Fitted, n: int, spread: Array | None = None, flown: int = 0) -> dict[str, dict[str, Interval]]:
    """95 % intervals of every effect's parameters: sandwich over tosses, Student's quantile.

    What flight has shown is told as well as flight tells it: contact, which could tell it better, leaves it where it is
    as often as it moves it to where it belongs.

    Args:
        flown: how many of the effects, the first, flight has shown.
        spread: (P,) standard deviations over where tosses were cut, one more source of error.
    """
    out: dict[str, dict[str, Interval]] = {}
    if not fitted.hypothesis.effects:
        return out
    error = np.sqrt(np.diag(_covariance(fitted, n, spread, flown)))
    quantile = float(student.ppf(0.975, max(1, n - len(error))))
    low, high = fitted.hypothesis.bounds
    k = 0
    for effect, values in zip(fitted.hypothesis.effects, fitted.hypothesis.values, strict=True):
        named = {}
        for parameter, value in zip(effect.parameters, values, strict=True):
            value = float(np.clip(value, low[k], high[k]))
            named[parameter.name] = Interval(value, value - quantile * error[k], value + quantile * error[k])
            k += 1
        out[effect.name] = named
    return out


def _covariance(fitted: Fitted, n: int, spread: Array | None, flown: int) -> Array:
    """(P, P) of all parameters, by every source of error that `intervals` names."""
    cov = fitted.covariance()
    variance = np.maximum(np.diag(cov), 0.0)
    first = sum(len(effect.parameters) for effect in fitted.hypothesis.effects[:flown])
    if first:
        variance[:first] = np.maximum(variance[:first], _in_flight(fitted, flown, n))
    if spread is not None:
        variance = variance + spread**2
    return cov + np.diag(variance - np.diag(cov))


def _in_flight(fitted: Fitted, flown: int, n: int) -> Array:
    """(P,) variances of the parameters of so many effects, the first, by the windows of free flight alone."""
    effects = fitted.hypothesis.effects[:flown]
    free = np.flatnonzero(fitted.evidence.windows.free)
    chosen = list(range(sum(len(effect.parameters) for effect in effects)))
    e, residual = fitted.evidence.rows(free), fitted.residual[free]
    J = derivatives(e, fitted.hypothesis, residual, chosen)[..., chosen]
    H, g = (each / FLIGHT_WEIGHT for each in toss_sums(e, residual, J, fitted.scales, n))
    flight = Fitted(
        Hypothesis(fitted.hypothesis.base, effects, fitted.hypothesis.values[:flown]), e, residual, fitted.scales, H, g
    )
    return np.maximum(np.diag(flight.covariance()), 0.0)
