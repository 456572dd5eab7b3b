"""Which effect changes over the order of recording, where, and by how much.

Each toss says by itself what an effect's parameters are (`values`). Where these change over the order is found and
tested as changes of a recording are (`tossid.motion.sessions.change_points`): by permutation, for all effects together.
Many effects seem to change where one does. What each that may be the cause gains from session to session is compared by
likelihood (`suspects`), and the promising ones are fitted. What happens is one of two things: steps at the changes, or
a drift. Each effect that gains is fitted to each toss alone; its values follow steps or a line (`drift`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from tossid.diagnosis.likelihood.fitting import fit
from tossid.diagnosis.selection.cross_validation import Candidate, CrossValidator
from tossid.diagnosis.sessions.drift import drifting, fitted_alone, follows_line
from tossid.diagnosis.sessions.moments import at_sessions, clearest_steps
from tossid.diagnosis.sessions.stretches import EffectOverOrder, fitted_stretches, rows_of, with_steps
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

    def screened(effect: Effect) -> float:
        witness = witnesses[effect.name]
        gain = gain_of_change(present, effect, witness, steps, shares=shares, outlier=outlier)
        return gain - 0.5 * (len(steps) - 2) * len(effect.parameters) * float(np.log(n))

    def near(effect: Effect, edges: Sequence[int]) -> list[Array]:
        said = witnesses[effect.name]
        moved = (stepped(present.hypothesis, effect, said, a, b, outlier=outlier) for a, b in pairwise(edges))
        return [each.values_of(effect.name) for each in moved]

    def p_of(effect: Effect) -> float:
        # (what does the same as others changes as surely as they do)
        return p.get(effect.name, max(p.values()))

    def stepping(effect: Effect) -> EffectOverOrder:
        fits = fitted_stretches(present, effect, steps, validator, near=near(effect, steps))
        return with_steps(effect, steps, fits, p_of(effect))

    def in_its_form(each: EffectOverOrder) -> EffectOverOrder:
        alone = fitted_alone(present, each.effect, validator, near(each.effect, range(n + 1)))
        line = follows_line(alone.values, alone.info, at, settings, known=boundaries)
        return drifting(alone, validator, settings, each.p_value) if line else each

    gains = dict(zip((each.name for each in suspects), validator.map(screened, suspects), strict=True))
    suspects = sorted(suspects, key=lambda each: -gains[each.name])[: settings.candidates]
    found = validator.map(stepping, suspects)
    found = validator.map(in_its_form, [each for *_, each in _gaining(present, found, settings)])
    unfelt = [each for each in library if unfelt_in_part(witnesses.get(each.name), steps)]
    from_starts = fits_from_starts(present, unfelt, steps, validator, count=settings.from_starts)
    found += [with_steps(effect, steps, fits, max(p.values())) for effect, fits in from_starts]
    judged = _gaining(present, found, settings)
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
    return _simplest(_gains_beside_constants(present, [each for *_, each in found], validator, settings), settings)


def _gains_beside_constants(
    present: Candidate, found: Sequence[EffectOverOrder], validator: CrossValidator, settings: OrderSettings
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
        if each.form == "drift":
            alone = fitted_alone(beside, each.effect, validator, list(each.values))
            fits = drifting(alone, validator, settings, each.p_value).fitted
        else:
            own = [one.hypothesis.values_of(each.effect.name) for one in each.fitted]
            fits = fitted_stretches(beside, each.effect, each.edges, validator, near=own)
        after = np.zeros(len(before))
        for k, one in enumerate(fits):
            after[rows_of(present, each.edges, k)] = one.evidence.log_likelihood(one.residuals, fitted.scales)
        gains.append((fitted.evidence.weighted_gain(after, before) - _cost(each), each))
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
        whole, over_mean = (gain - _cost(each) for gain in _gains(present, each))
        if over_mean > settings.least_gain and each.differ < settings.significance:
            gains.append((whole, over_mean, each))
    most = max((over_mean for _, over_mean, _ in gains), default=0.0)
    return [each for each in gains if each[1] > settings.comparable * most]


def _cost(each: EffectOverOrder) -> float:
    """Of the numbers that a change has beside the effect's mean (Schwarz 1978)."""
    return 0.5 * each.numbers * float(np.log(each.edges[-1]))


def _gains(present: Candidate, each: EffectOverOrder) -> tuple[float, float]:
    """What an effect gains by values of its own in each stretch, over none of it, and over its mean in all tosses."""
    evidence, scales = present.evidence, present.fitted.scales
    before = evidence.log_likelihood(present.fitted.residuals, scales)
    after = np.zeros(len(before))
    for k, one in enumerate(each.fitted):
        after[rows_of(present, each.edges, k)] = one.evidence.log_likelihood(one.residuals, scales)
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
