"""Which effect changes over the order of recording, where, and by how much.

Each toss says by itself what an effect's parameters are (`values`). Where these change over the order is found and
tested as changes of a recording are (`tossid.motion.sessions.change_points`): by permutation, for all effects together.
Many effects seem to change where one does. What each that may be the cause gains from session to session is compared by
likelihood (`suspects`), and the promising ones are fitted. What happens is one of two things: steps at the changes, or
a drift. The first of the suspects is fitted to parts of the order, none with a step in it; its values follow steps or a
line.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2
from scipy.stats import t as student_t

from tossid.diagnosis.findings import Interval
from tossid.diagnosis.likelihood.fitting import Fitted, fit
from tossid.diagnosis.selection.cross_validation import Candidate, CrossValidator
from tossid.diagnosis.sessions.correction import CORRECTABLE
from tossid.diagnosis.sessions.moments import at_sessions, clearest_steps, parts_between
from tossid.diagnosis.sessions.suspects import (
    fits_from_starts,
    gain_of_change,
    stepped,
    suspects_among,
    unfelt_in_part,
)
from tossid.diagnosis.sessions.values import RESIDUAL
from tossid.motion.sessions.change_points import Change, Witness, changes_at, find_changes
from tossid.physics.effects import Effect
from tossid.settings.diagnosis.order import OrderSettings

Array = NDArray[np.float64]
Form = Literal["steps", "drift"]
_HALF_WIDTH = 1.96
"""Of a 95 % interval, in standard deviations."""


@dataclass(frozen=True, eq=False)
class EffectOverOrder:
    """An effect that is not the same in all tosses.

    Attributes:
        effect: The effect.
        form: How it goes over the order.
        edges: First tosses of the stretches in which it was fitted, and the number of tosses, (k + 1,). Of steps these
            are the sessions.
        values: (n, P) its parameters in each toss.
        p_value: Probability of such a change in an order that means nothing, corrected for all that was looked at.
        parameters: Over all tosses, the mean of each parameter.
        stretches: Of each stretch, the parameters.
        rate: Of a drift, the change of each parameter from toss to toss; empty of steps.
        fitted: The fits of the stretches.
    """

    effect: Effect
    form: Form
    edges: tuple[int, ...]
    values: Array
    p_value: float
    parameters: dict[str, Interval]
    stretches: tuple[dict[str, Interval], ...]
    rate: dict[str, Interval]
    fitted: tuple[Fitted, ...]

    @property
    def correctable(self) -> bool:
        """Whether it is an error of the recording that can be undone toss by toss."""
        return self.effect.name in CORRECTABLE


def changes_over_order(
    witnesses: Mapping[str, Witness], settings: OrderSettings, *, boundaries: Sequence[int] = ()
) -> tuple[Change, ...]:
    """Where anything changes over the order.

    Where only the size of the gap changes, it is known that something does, and when: effects are tested there, too.

    Args:
        witnesses: Of `witnesses_of`.
        settings: Significance and the smallest session.
        boundaries: Numbers of tosses with which sessions of the dataset begin. Where no change is found near one, it is
            one of what changes there.
    """
    found = [
        Change(each.at, {**changes_at(witnesses, each.at, settings=settings.changes), **each.p})
        if set(each.p) == {RESIDUAL}
        else each
        for each in find_changes(witnesses, settings=settings.changes)
    ]
    n = len(next(iter(witnesses.values()))[0])
    for at in boundaries:
        near = any(abs(change.at - at) <= settings.same_change for change in found)
        if not near and settings.fewest_tosses <= at <= n - settings.fewest_tosses:
            p = changes_at(witnesses, at, settings=settings.changes)
            found += [Change(at, p)] if p else []
    return tuple(sorted(found, key=lambda change: change.at))


def effect_over_order(
    present: Candidate,
    validator: CrossValidator,
    library: Sequence[Effect],
    witnesses: Mapping[str, Witness],
    changes: Sequence[Change],
    settings: OrderSettings,
    *,
    boundaries: Sequence[int] = (),
) -> EffectOverOrder | None:
    """The effect whose change over the order explains most; None if no effect changes.

    Args:
        present: The hypothesis beside which it changes.
        validator: Of all windows.
        library: The effects among which it is.
        witnesses: Of `witnesses_of`.
        changes: Of `changes_over_order`.
        settings: How candidates are compared.
        boundaries: Numbers of tosses with which sessions of the dataset begin.
    """
    p = {name: min(c.p[name] for c in changes if name in c.p) for c in changes for name in c.p}
    suspects = [each for each in suspects_among(library, p) if each.name in witnesses]
    outlier, n = settings.changes.outlier, validator.n
    at = at_sessions(clearest_steps(witnesses, changes, settings), boundaries, settings.same_change)
    steps, shares = (0, *at, n), validator.settings.selection.step_shares
    parts = max(2, min(settings.drift_parts, n // settings.changes.fewest_tosses))
    parts_of_drift = parts_between(n, parts, at)

    def screened(effect: Effect) -> float:
        witness = witnesses[effect.name]
        gain = gain_of_change(present, effect, witness, steps, shares=shares, outlier=outlier)
        return gain - _cost(effect, steps)

    def fitted(effect: Effect, form: Form, edges: tuple[int, ...]) -> EffectOverOrder:
        near = [
            stepped(present.hypothesis, effect, witnesses[effect.name], a, b, outlier=outlier).values_of(effect.name)
            for a, b in pairwise(edges)
        ]
        fits = fitted_stretches(present, effect, edges, validator, near=near)
        # (what does the same as others changes as surely as they do)
        return described(effect, form, edges, fits, p.get(effect.name, max(p.values())))

    gains = dict(zip((each.name for each in suspects), validator.map(screened, suspects), strict=True))
    suspects = sorted(suspects, key=lambda each: -gains[each.name])[: settings.candidates]
    found: list[EffectOverOrder] = []
    if suspects:
        # (what changes with the dataset's sessions alone does not drift)
        in_sessions = set(at) <= set(boundaries)
        drifting = None if in_sessions else fitted(suspects[0], "drift", parts_of_drift)
        if drifting is not None and follows_line(drifting, at):
            found = [drifting, *validator.map(partial(fitted, form="drift", edges=parts_of_drift), suspects[1:])]
        else:
            found = validator.map(partial(fitted, form="steps", edges=steps), suspects)
    judged = _gaining(present, found, settings)
    if judged and found[0].form == "drift":
        return _chosen(present, judged, validator, settings)
    unfelt = [each for each in library if unfelt_in_part(witnesses.get(each.name), steps)]
    from_starts = fits_from_starts(present, unfelt, steps, validator, count=settings.from_starts)
    found += [described(effect, "steps", steps, fits, max(p.values())) for effect, fits in from_starts]
    judged = _gaining(present, found, settings) if from_starts else judged
    return _chosen(present, judged, validator, settings) if judged else None


def _chosen(
    present: Candidate,
    found: Sequence[tuple[float, float, EffectOverOrder]],
    validator: CrossValidator,
    settings: OrderSettings,
) -> EffectOverOrder:
    """Of effects that change, the one whose change explains most.

    What an effect gains on the whole includes what is the same in all tosses, which another might explain as well. What
    it gains over its mean lacks what its mean takes of the change. Where the two disagree, each change is fitted beside
    the constant values of the others that suit all tosses best.
    """
    whole = _simplest([(gain, each) for gain, _, each in found], settings)
    over_mean = _simplest([(gain, each) for _, gain, each in found], settings)
    if whole is over_mean:
        return whole
    return _simplest(_gains_beside_constants(present, [each for *_, each in found], validator), settings)


def _gains_beside_constants(
    present: Candidate, found: Sequence[EffectOverOrder], validator: CrossValidator
) -> list[tuple[float, EffectOverOrder]]:
    """What each of some changes gains where all of these effects have the constant values that suit all tosses best."""
    hypothesis = present.hypothesis
    for each in found:
        if each.effect.name not in hypothesis.names:
            hypothesis = hypothesis.plus(each.effect)
    fitted = fit(present.evidence, hypothesis, n_tosses=validator.n, held=frozenset(present.hypothesis.names))
    beside, gains = replace(present, fitted=fitted), []
    before = fitted.evidence.log_likelihood(fitted.residuals, fitted.scales)
    for each in found:
        own = [one.hypothesis.values_of(each.effect.name) for one in each.fitted]
        fits = fitted_stretches(beside, each.effect, each.edges, validator, near=own)
        after = np.zeros(len(before))
        for k, one in enumerate(fits):
            after[_rows(present, each.edges, k)] = one.evidence.log_likelihood(one.residuals, fitted.scales)
        gain = fitted.evidence.weighted_gain(after, before)
        gains.append((gain - _cost(each.effect, each.edges), each))
    return gains


def _gaining(
    present: Candidate, found: Sequence[EffectOverOrder], settings: OrderSettings
) -> list[tuple[float, float, EffectOverOrder]]:
    """The effects whose change gains enough: what each gains on the whole, and over its mean.

    What an effect gains over its mean says whether it changes, and not that it merely is there in all tosses. Its
    values must differ by more than tosses scatter, too: a few odd tosses can bring much likelihood.
    """
    gains = []
    for each in found:
        whole, over_mean = (gain - _cost(each.effect, each.edges) for gain in _gains(present, each))
        if over_mean > settings.least_gain and values_differ(each) < settings.significance:
            gains.append((whole, over_mean, each))
    most = max((over_mean for _, over_mean, _ in gains), default=0.0)
    return [each for each in gains if each[1] > settings.comparable * most]


def values_differ(each: EffectOverOrder) -> float:
    """Probability of values that differ as much between stretches if all are one, by Wald's test (1943).

    Args:
        each: The effect, with its fits, whose errors are from the scatter of tosses.
    """
    name = each.effect.name
    values = [one.hypothesis.values_of(name) for one in each.fitted]
    places = [one.hypothesis.place_of(name) for one in each.fitted]
    information = [np.linalg.pinv(one.covariance()[at, at]) for one, at in zip(each.fitted, places, strict=True)]
    weighted = [W @ y for W, y in zip(information, values, strict=True)]
    mean = np.linalg.pinv(np.sum(information, axis=0)) @ np.sum(weighted, axis=0)
    squared = sum((y - mean) @ W @ (y - mean) for W, y in zip(information, values, strict=True))
    return float(chi2.sf(squared, (len(values) - 1) * len(mean)))


def _cost(effect: Effect, edges: Sequence[int]) -> float:
    """Of an effect's numbers in all stretches but one (Schwarz 1978)."""
    return 0.5 * (len(edges) - 2) * len(effect.parameters) * float(np.log(edges[-1]))


def follows_line(each: EffectOverOrder, at: Sequence[int]) -> bool:
    """Whether values of parts of the order follow a line rather than steps, which cost more where they are many.

    Args:
        each: Fitted to the parts.
        at: First tosses after the steps. A part in which there is a step has that share of it.
    """
    y = np.array([[part[p.name].value for p in each.effect.parameters] for part in each.stretches])
    half = np.array([[part[p.name].high - part[p.name].low for p in each.effect.parameters] for part in each.stretches])
    sigma = np.maximum(np.median(half, axis=0), 1e-12) / (2 * _HALF_WIDTH)
    (k, d), edges, order = y.shape, each.edges, np.arange(each.edges[-1])
    parts = [slice(a, b) for a, b in pairwise(edges)]
    costs = []
    for design in (order[:, None], order[:, None] >= np.asarray(at)):
        X = np.column_stack([np.ones(k), [design[part].mean(axis=0) for part in parts]])
        off = (y - X @ np.linalg.lstsq(X, y, rcond=None)[0]) / sigma
        costs.append(float((off**2).sum()) + X.shape[1] * d * np.log(k))
    return costs[0] < costs[1]


def _gains(present: Candidate, each: EffectOverOrder) -> tuple[float, float]:
    """What an effect gains by values of its own in each stretch, over none of it, and over its mean in all tosses."""
    evidence, scales = present.evidence, present.fitted.scales
    before = evidence.log_likelihood(present.fitted.residuals, scales)
    after = np.zeros(len(before))
    for k, one in enumerate(each.fitted):
        after[_rows(present, each.edges, k)] = one.evidence.log_likelihood(one.residuals, scales)
    mean = present.hypothesis.minus(each.effect.name)
    mean = mean.plus(each.effect, np.array([each.parameters[p.name].value for p in each.effect.parameters]))
    same = evidence.relinearised(mean.world(), refine=4).log_likelihood_of(mean.world(), scales)
    whole = evidence.weighted_gain(after, before)
    return whole, whole - max(evidence.weighted_gain(same, before), 0.0)


def _simplest(found: Sequence[tuple[float, EffectOverOrder]], settings: OrderSettings) -> EffectOverOrder:
    """Of effects with their gains, the one that gains most, or a simpler story that gains nearly as much."""
    best = max(gain for gain, _ in found)
    # the object and gravity stay the same
    changeable = [each for each in found if each[1].effect.family != "body" and each[1].effect.name != "gravity"]
    if changeable and max(gain for gain, _ in changeable) > settings.unchanging * best:
        found = changeable
        best = max(gain for gain, _ in found)
    # of what fits alike, a recording that changes is the simpler story
    recording = [each for each in found if each[1].effect.family == "measurement" or each[1].correctable]
    recording = [each for each in recording if each[0] > best - settings.indistinguishable * best]
    gain, chosen = max(recording or found, key=lambda each: each[0])
    # and so is a special case, which can gain no more
    while inner := [
        each for each in found if each[1].effect.name in chosen.effect.contains and each[0] > settings.special * gain
    ]:
        gain, chosen = max(inner, key=lambda each: each[0])
    return chosen


def _rows(present: Candidate, edges: Sequence[int], k: int) -> NDArray[np.int64]:
    """Numbers of the windows of a stretch's tosses."""
    toss = present.evidence.windows.toss
    return np.flatnonzero((toss >= edges[k]) & (toss < edges[k + 1]))


def fitted_stretches(
    present: Candidate,
    effect: Effect,
    edges: Sequence[int],
    validator: CrossValidator,
    *,
    near: Sequence[Array],
) -> tuple[Fitted, ...]:
    """An effect beside a hypothesis, fitted to each stretch of tosses; the hypothesis's other effects stay.

    Args:
        present: The hypothesis.
        effect: The effect.
        edges: First tosses of the stretches, and n.
        validator: Of all windows.
        near: The effect's parameters (P,) in each stretch from which its fit starts, if they suit better than the
            hypothesis's.
    """
    hypothesis = present.hypothesis
    if effect.name not in hypothesis.names:
        hypothesis = hypothesis.plus(effect)
    place = hypothesis.place_of(effect.name)
    held = frozenset(hypothesis.names) - {effect.name}
    out = []
    for k in range(len(edges) - 1):
        flat = hypothesis.flat()
        flat[place] = near[k]
        start = hypothesis.at(flat)
        evidence = present.evidence.rows(_rows(present, edges, k))
        scales = present.fitted.scales
        there, here = (evidence.log_likelihood_of(each.world(), scales) for each in (start, hypothesis))
        begin = start if evidence.weighted_gain(there, here) > 0 else hypothesis
        out.append(fit(evidence, begin, n_tosses=validator.n, held=held))
    return tuple(out)


def described(
    effect: Effect, form: Form, edges: tuple[int, ...], fits: tuple[Fitted, ...], p_value: float
) -> EffectOverOrder:
    """An effect over the order from the fits of its stretches.

    Args:
        effect: The effect.
        form: Steps or drift.
        edges: First tosses of the stretches, and n.
        fits: Of the stretches.
        p_value: Of the change.
    """
    n, sizes = edges[-1], np.diff(edges)
    values, variances = [], []
    for one in fits:
        place = one.hypothesis.place_of(effect.name)
        values.append(one.hypothesis.values_of(effect.name))
        variances.append(np.diag(one.covariance())[place])
    y, var, size = np.array(values), np.array(variances), len(effect.parameters)
    freedom = np.maximum(sizes - size, 1)
    names = [p.name for p in effect.parameters]

    def intervals(at: Array, of: Array, degrees: float) -> dict[str, Interval]:
        half = student_t.ppf(0.975, degrees) * np.sqrt(of)
        return {
            name: Interval(float(x), float(x - h), float(x + h)) for name, x, h in zip(names, at, half, strict=True)
        }

    share = (sizes / n)[:, None]
    whole = intervals((share * y).sum(0), (share**2 * var).sum(0), max(n - size, 1))
    stretches = tuple(intervals(y[k], var[k], float(freedom[k])) for k in range(len(fits)))
    if form == "steps":
        return EffectOverOrder(effect, form, edges, np.repeat(y, sizes, axis=0), p_value, whole, stretches, {}, fits)
    middle = 0.5 * (np.array(edges[:-1]) + np.array(edges[1:]) - 1)
    w = 1 / np.maximum(var, 1e-300)
    centre = (w * middle[:, None]).sum(0) / w.sum(0)
    spread = (w * (middle[:, None] - centre) ** 2).sum(0)
    level = (w * y).sum(0) / w.sum(0)
    slope = (w * (middle[:, None] - centre) * y).sum(0) / spread
    # stretches scatter about the line at least as their own errors say
    off = (w * (y - level - slope * (middle[:, None] - centre)) ** 2).sum(0) / max(len(fits) - 2, 1)
    rate = intervals(slope, np.maximum(off, 1.0) / spread, max(len(fits) - 2, 1))
    line = level + slope * (np.arange(n)[:, None] - centre)
    return EffectOverOrder(effect, form, edges, line, p_value, whole, stretches, rate, fits)
