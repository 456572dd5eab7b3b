"""What the tosses say of each effect of a library: its verdict, its parameters, and the size that they would reveal."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from tossid.diagnosis.findings import Consequence, EffectVerdict, Finding, Interval
from tossid.diagnosis.likelihood.derivatives import effect_derivatives
from tossid.diagnosis.likelihood.fitting import standard_errors
from tossid.diagnosis.localisation.gap import share_left
from tossid.diagnosis.localisation.noise import Floor
from tossid.diagnosis.selection.cross_validation import Candidate, CrossValidator
from tossid.diagnosis.selection.refinement import correlations, intervals, stated_intervals
from tossid.diagnosis.selection.search_result import SearchResult
from tossid.physics.effects import Effect
from tossid.types import Phase

Array = NDArray[np.float64]
NOTHING = Interval(0.0, 0.0, 0.0)
"""The interval of a parameter that is not there."""
_RANK = {"identified": 0, "confusable": 0, "candidate": 0, "not_supported": 2, "not_identifiable": 3}
"""Order of statuses in a table."""


def effect_findings(
    library: Sequence[Effect],
    validator: CrossValidator,
    found: SearchResult,
    named: Sequence[str],
    floor: Floor,
    spread: Array | None,
    closed: Mapping[str, Interval],
    consequence: Mapping[str, Consequence] = MappingProxyType({}),
    candidates: Collection[str] = (),
) -> tuple[Finding, ...]:
    """A finding for each effect, named ones and their classes first, the others by evidence.

    Args:
        library: The effects.
        validator: Of all windows.
        found: What the search found.
        named: Names of the effects that are named, ordered by what is lost without each.
        floor: The noise floor.
        spread: (P,) standard deviations of parameters over shifted windows.
        closed: Share of the gap that each effect of the last hypothesis closes, by name.
        consequence: What each of them does to whole tosses, by name.
        candidates: Names of effects that are significant, and not sure enough to be identified.
    """
    known = stated_intervals(found, validator.n, spread)
    related = correlations(found.present.fitted, validator.n, spread, found.n_flight)
    stands_for = {each.name: (name, each) for name, group in found.classes.items() for each in group}
    ours, theirs = found.exchanged
    named_ours = tuple(name for name in ours if name in named)
    leaders = {name: leader for name, (leader, _) in stands_for.items()}
    leaders |= {name: named_ours[0] for name in theirs if named_ours and name not in leaders}
    out = []
    for effect in library:
        alone = found.first_round.get(effect.name)
        judged = alone or found.flight_round.get(effect.name)
        closes = closed.get(effect.name, NOTHING)
        if alone is not None and effect.name not in closed:
            closes = share_left(found.first, alone, validator, floor)[0]
        confusable_with: tuple[str, ...] = ()
        parameters: dict[str, Interval] = {}
        correlation: tuple[tuple[float, ...], ...] = ()
        sizes, detectable = detectable_sizes(validator, found.present, effect)
        verdict: EffectVerdict
        if effect.name in named:
            judged, parameters = found.needed[effect.name], known[effect.name]
            correlation = related[effect.name]
            confusable_with = tuple(each.name for each in found.stand_ins(effect.name))
            verdict = "confusable" if confusable_with else "identified"
            verdict = "candidate" if effect.name in candidates else verdict
        elif effect.name in stands_for:
            name, each = stands_for[effect.name]
            judged, parameters = each, intervals(each.fitted, validator.n)[effect.name]
            correlation = correlations(each.fitted, validator.n)[effect.name]
            closes = closed[name]
            confusable_with = (name, *(o.name for o in found.classes[name] if o.name != effect.name))
            verdict = "candidate" if name in candidates else "confusable"
        elif effect.name in leaders and found.other_causes is not None:
            fitted = found.other_causes.candidate.fitted
            judged = found.other_causes.needed[effect.name]
            parameters = intervals(fitted, validator.n)[effect.name]
            correlation = correlations(fitted, validator.n)[effect.name]
            closes, confusable_with = closed[leaders[effect.name]], named_ours
            verdict = "confusable" if {*named_ours} - {*candidates} else "candidate"
        else:
            verdict = "not_supported" if detectable else "not_identifiable"
        evidence = {
            "gain": 0.0 if judged is None else judged.total,
            "p_value": 1.0 if judged is None else judged.p_value,
            "n_tosses": float(validator.n),
        }
        phases = tuple(Phase(phase).name.lower() for phase in effect.phases)
        out.append(
            Finding(
                effect.name,
                verdict,
                effect.says,
                phases,
                parameters,
                evidence,
                closes,
                confusable_with,
                sizes,
                consequence.get(leaders.get(effect.name, effect.name)),
                correlation=correlation,
                saturated=effect.name in found.saturated,
            )
        )
    order = {name: i for i, name in enumerate(named)}

    def rank(finding: Finding) -> tuple[float, float, bool, float]:
        place = order.get(leaders.get(finding.name, finding.name), validator.n)
        return _RANK[finding.verdict], place, finding.name not in order, -finding.evidence["gain"]

    return tuple(sorted(out, key=rank))


def closed_by_each(validator: CrossValidator, found: SearchResult, floor: Floor) -> dict[str, Interval]:
    """Share of the gap that each effect of the last hypothesis closed when it joined, beyond those before it.

    An effect that has replaced another which flight revealed closes what that one closed.

    Args:
        validator: Of all windows.
        found: What the search found.
        floor: The noise floor.
    """
    shares = [share_left(found.first, each, validator, floor)[0] for each in found.history[1:]]
    names = [each.hypothesis.names for each in found.history[1:]]
    out = {}
    for i, name in enumerate(found.present.hypothesis.names):
        k = i if i < found.n_flight else next(k for k, inside in enumerate(names) if name in inside)
        before = (shares[k - 1] if k else NOTHING).value
        out[name] = Interval(shares[k].value - before, shares[k].low - before, shares[k].high - before)
    return out


def detectable_sizes(validator: CrossValidator, present: Candidate, effect: Effect) -> tuple[dict[str, float], bool]:
    """The smallest size of each parameter that these tosses would reveal, and whether any is within its range.

    Args:
        validator: Of all windows.
        present: The hypothesis beside which the effect is sought.
        effect: The effect.
    """
    residuals, settings = present.fitted.residuals, validator.settings.verdict
    _, _, J = effect_derivatives(present.evidence, present.hypothesis, effect, residuals)
    errors = standard_errors(present.evidence, residuals, J, present.fitted.scales)
    sizes, detectable = {}, False
    for parameter, error in zip(effect.parameters, errors, strict=True):
        if np.isfinite(error):
            size = settings.detectable * parameter.step * float(error)
            sizes[parameter.name] = size
            detectable = detectable or size < settings.detectable_range * (parameter.high - parameter.low)
    return sizes, detectable
