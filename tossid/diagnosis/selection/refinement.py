"""Refinement of the selected hypothesis, whose likelihood contact makes rough, and intervals of its parameters.

A fit ends near where it began. So effects of contact are moved by a line search, and the hypothesis is refitted on
shifted windows from perturbed starts. Effects that are not clearly other than nominal there are pruned, and the scatter
of these fits is part of the intervals.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2
from scipy.stats import t as student

from tossid.diagnosis.findings import Interval
from tossid.diagnosis.likelihood.derivatives import derivatives
from tossid.diagnosis.likelihood.evidence import Hypothesis
from tossid.diagnosis.likelihood.fitting import Fitted, toss_sums
from tossid.diagnosis.likelihood.windows import make_windows
from tossid.diagnosis.selection.cross_validation import Candidate, CrossValidator
from tossid.diagnosis.selection.search_result import SearchResult
from tossid.objects import ObjectModel
from tossid.physics.effects import Effect
from tossid.types import Phase, Toss

Array = NDArray[np.float64]


def line_searched(validator: CrossValidator, found: SearchResult) -> SearchResult:
    """The search's result with each effect of contact that has one parameter moved to where it fits best.

    The parameter is moved away from its nominal value and towards it, by shares that halve, wherever that is better at
    first states that are sought anew: for some of the tosses first, and then for all.

    Args:
        validator: Of all windows.
        found: What the search found.
    """
    present, settings = found.present, validator.settings.refinement
    rows = np.flatnonzero(validator.screening[validator.windows.toss])
    part = replace(validator, windows=validator.windows.rows(rows))

    def moved_by(effect: Effect, present: Candidate, share: float) -> Candidate | None:
        """With an effect's values moved to a share of their distance from nominal ones; None if that is not better."""
        nominal, values = effect.nominal(present.hypothesis.base), present.hypothesis.values_of(effect.name)
        moved = present.hypothesis.with_instead(effect.name, effect, nominal + share * (values - nominal))
        moved = moved.clipped(moved.flat())
        if present.fitted.gain_of(moved) < -settings.hopeless:
            return None
        before = replace(present, log_likelihood=present.log_likelihood[rows])
        if part.gain_over(part.evaluate(moved), before).sum() <= 0:
            return None
        there = validator.evaluate(moved)
        return there if validator.gain_over(there, present).sum() > settings.least_gain else None

    for effect in present.hypothesis.effects[found.n_flight :]:
        move = settings.largest_move if len(effect.parameters) == 1 else 0.0
        while move > settings.smallest_move:
            judged = partial(moved_by, effect, present)
            for there in validator.each(judged, (1.0 + move, 1.0 - move)):
                if there is not None:
                    present = there
                    break
            else:
                move *= 0.5
    if present is found.present:
        return found
    return found.ending_in(validator.cross_validate(present, found.present.effect, present.hypothesis))


def refitted_on_shifted_windows(
    tosses: Sequence[Toss], model: ObjectModel, validator: CrossValidator, found: SearchResult
) -> tuple[SearchResult, Array | None]:
    """The search's result at the medians of fits to shifted windows, which no single cut of the tosses decides.

    Each fit begins at perturbed values, to either side of the present ones. What acts in flight is perturbed less: its
    values are near where they belong, and moved far away they would be held there by first states in contact.

    Args:
        tosses: As recorded.
        model: Their object.
        validator: Of all windows.
        found: What the search found.

    Returns:
        The result, and the standard deviations (P,) of these fits, None without effects.
    """
    present, settings = found.present, validator.settings.refinement
    if not present.hypothesis.effects:
        return found, None
    if not np.diag(present.fitted.H.sum(0)).all():
        # what flight determines was held last, and has no derivatives; here all may move
        present = validator.cross_validate(present, present.effect, present.hypothesis, 0)
    flat, effects = present.hypothesis.flat(), present.hypothesis.effects
    nominal = np.concatenate([effect.nominal(present.hypothesis.base) for effect in effects])
    flies = [Phase.FLIGHT in effect.phases for effect in effects for _ in effect.parameters]
    error = np.sqrt(np.maximum(np.diag(present.fitted.covariance()), 0.0))
    away = np.where(flies, settings.flight_perturbation * error, settings.perturbation * (flat - nominal))
    away *= np.random.default_rng(len(flat)).choice([-1.0, 1.0], len(flat))
    likelihood = validator.settings.likelihood

    def fitted(k: int) -> Array:
        """(P,) values of the k-th fit; every second one begins on the other side."""
        shift, side = int(settings.shifts[k] * likelihood.windows.length), -1.0 if k % 2 else 1.0
        other = replace(validator, windows=make_windows(tosses, model, settings=likelihood, shift=shift))
        start = present.hypothesis.clipped(flat + side * away)
        there = other.refit(other.evaluate(start).evidence, start, 1)
        back = there.evidence.relinearised(present.hypothesis.world(), refine=4)
        before = back.log_likelihood_of(present.hypothesis.world(), there.scales)
        after = there.evidence.log_likelihood(there.residuals, there.scales)
        if there.evidence.weighted_gain(after, before) < 0:
            # the fit has ended in a worse place than the unperturbed start
            there = other.refit(back, present.hypothesis, 1)
        return there.hypothesis.flat()

    values = np.array([flat, *validator.map(fitted, range(len(settings.shifts)))])
    median = validator.cross_validate(present, present.effect, present.hypothesis.at(np.median(values, axis=0)), 0)
    if validator.p_value_over(present, median) < validator.settings.selection.class_level:
        # medians of parameters that make up for each other need not make up for each other
        median = present
    return found.ending_in(median), np.std(values, axis=0, ddof=1)


def pruned_by_wald_test(
    validator: CrossValidator, found: SearchResult, spread: Array | None
) -> tuple[SearchResult, Array | None]:
    """Without effects of contact whose values are not clearly other than nominal, the least clear first.

    They gained something with the first windows, and not with shifted ones.

    Args:
        validator: Of all windows.
        found: What the search found.
        spread: (P,) standard deviations over shifted windows.

    Returns:
        The result, and the standard deviations of what stays.
    """
    while spread is not None and (name := _least_clear(validator, found, spread)):
        hypothesis = found.present.hypothesis
        own = hypothesis.place_of(name)
        pruned = validator.cross_validate(found.present, None, hypothesis.minus(name))
        found, spread = found.ending_in(pruned).without(name), np.delete(spread, own)
    return found, spread


def _least_clear(validator: CrossValidator, found: SearchResult, spread: Array) -> str | None:
    """The effect of contact that is least clearly other than nominal (Wald's test); None if each is clear."""
    hypothesis = found.present.hypothesis
    cov = _covariance(found.present.fitted, validator.n, spread, found.n_flight)
    least, name = validator.settings.refinement.level, None
    for effect in hypothesis.effects[found.n_flight :]:
        own = hypothesis.place_of(effect.name)
        size = np.sqrt(np.diag(cov)[own])
        away = (hypothesis.values_of(effect.name) - effect.nominal(hypothesis.base)) / size
        correlation = cov[own, own] / np.outer(size, size)
        p_value = float(chi2.sf(away @ np.linalg.pinv(correlation, hermitian=True) @ away, len(away)))
        if not effect.near_nothing and effect.name not in found.saturated and p_value > least:
            least, name = p_value, effect.name
    return name


def intervals(fitted: Fitted, n: int, spread: Array | None = None, n_flight: int = 0) -> dict[str, dict[str, Interval]]:
    """95 % intervals of every effect's parameters: sandwich estimate over tosses, Student's quantile.

    What flight determines is no better known than by flight alone: contact, which could determine it better, moves it
    away from the truth as often as towards it. No interval goes beyond what is physically possible.

    Args:
        fitted: The hypothesis.
        n: How many tosses.
        spread: (P,) standard deviations over shifted windows, one more source of error.
        n_flight: How many of the effects, the first, were found in flight.
    """
    out: dict[str, dict[str, Interval]] = {}
    if not fitted.hypothesis.effects:
        return out
    error = np.sqrt(np.diag(_covariance(fitted, n, spread, n_flight)))
    quantile = float(student.ppf(0.975, max(1, n - len(error))))
    low, high = fitted.hypothesis.bounds
    k = 0
    for effect, values in fitted.hypothesis.items():
        named = {}
        for parameter, value in zip(effect.parameters, values, strict=True):
            value = float(np.clip(value, low[k], high[k]))
            ends = np.clip(value + np.array([-1.0, 1.0]) * quantile * error[k], low[k], high[k])
            named[parameter.name] = Interval(value, *ends.tolist())
            k += 1
        out[effect.name] = named
    return out


def stated_intervals(found: SearchResult, n: int, spread: Array | None) -> dict[str, dict[str, Interval]]:
    """What is stated of a search's last hypothesis: `intervals`, but of sizes that tosses bound on one side only.

    Args:
        found: What the search found.
        n: How many tosses.
        spread: (P,) standard deviations over shifted windows.
    """
    out = intervals(found.present.fitted, n, spread, found.n_flight)
    for effect in found.present.hypothesis.effects:
        if effect.name in found.saturated:
            whole = found.saturated[effect.name]
            (size,) = (each.name for each in effect.parameters if not each.form)
            value = out[effect.name][size].value
            out[effect.name][size] = Interval(value, min(whole.low, value), max(whole.high, value))
    return out


def correlations(
    fitted: Fitted, n: int, spread: Array | None = None, n_flight: int = 0
) -> dict[str, tuple[tuple[float, ...], ...]]:
    """Correlations of the errors that `intervals` states, among the parameters of every effect.

    Args:
        fitted: The hypothesis.
        n: How many tosses.
        spread: (P,) standard deviations over shifted windows.
        n_flight: How many of the effects, the first, were found in flight.
    """
    hypothesis, out = fitted.hypothesis, {}
    if hypothesis.effects:
        cov = _covariance(fitted, n, spread, n_flight)
        error = np.sqrt(np.maximum(np.diag(cov), 1e-300))
        for name in hypothesis.names:
            own = hypothesis.place_of(name)
            rows = cov[own, own] / np.outer(error[own], error[own])
            out[name] = tuple(map(tuple, rows.tolist()))
    return out


def _covariance(fitted: Fitted, n: int, spread: Array | None, n_flight: int) -> Array:
    """(P, P) of all parameters, by every source of error that `intervals` names."""
    cov = fitted.covariance()
    variance = np.maximum(np.diag(cov), 0.0)
    first = sum(len(effect.parameters) for effect in fitted.hypothesis.effects[:n_flight])
    if first:
        variance[:first] = np.maximum(variance[:first], _flight_variances(fitted, n_flight, n))
    if spread is not None:
        variance = variance + spread**2
    return cov + np.diag(variance - np.diag(cov))


def _flight_variances(fitted: Fitted, n_flight: int, n: int) -> Array:
    """(P,) variances of the first effects' parameters by the windows of free flight alone."""
    hypothesis = fitted.hypothesis
    first = Hypothesis(hypothesis.base, hypothesis.effects[:n_flight], hypothesis.values[:n_flight])
    free = np.flatnonzero(fitted.evidence.windows.free)
    chosen = list(range(len(first.parameter_owners)))
    e, residuals = fitted.evidence.rows(free), fitted.residuals[free]
    J = derivatives(e, hypothesis, residuals, chosen)[..., chosen]
    weight = e.windows.settings.windows.flight_weight
    H, g = (each / weight for each in toss_sums(e, residuals, J, fitted.scales, n))
    flight = Fitted(first, e, residuals, fitted.scales, H, g)
    return np.maximum(np.diag(flight.covariance()), 0.0)
