"""The search in free flight alone, whose model is right but for the effects that are sought.

What acts there is found and named from windows without contact. Its name is that of the library's nearest effect, so
each force is fitted once more with a free power of its state: one that fits clearly better has another law, and no
name. Nor has an effect a name whose size differs from toss to toss.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from tossid.diagnosis.likelihood.evidence import Hypothesis
from tossid.diagnosis.selection.confusable import ConfusableClasses
from tossid.diagnosis.selection.cross_validation import Candidate, CrossValidator
from tossid.diagnosis.selection.forward_selection import ForwardSelection, SelectionPath
from tossid.diagnosis.selection.search_result import SearchResult
from tossid.diagnosis.selection.two_causes import with_two_causes
from tossid.diagnosis.under_way import UnderWay
from tossid.physics.effects import Effect
from tossid.types import Phase


def search_flight(validator: CrossValidator, library: Sequence[Effect], hypothesis: Hypothesis) -> SearchResult | None:
    """What the windows of free flight alone reveal; None where there are none.

    Args:
        validator: Of all windows.
        library: The effects to choose from; those that act in flight are.
        hypothesis: Without effects.
    """
    free = np.flatnonzero(validator.windows.free)
    if not len(free):
        return None
    flying = [effect for effect in library if Phase.FLIGHT in effect.phases]
    rounds = ForwardSelection(replace(validator, windows=validator.windows.rows(free)), flying, UnderWay())
    first = rounds.validator.evaluate(hypothesis)
    path = rounds.run(first, [first])
    found, apart = _concluded(rounds, path), with_two_causes(rounds, path)
    return found if apart is None else replace(found, instead=_concluded(rounds, apart))


def _concluded(rounds: ForwardSelection, path: SelectionPath) -> SearchResult:
    """What rounds in flight have found, with what could stand in for each effect, and which of them have no name."""
    first, last = path.history[0], path.history[-1]
    needed, classes = ConfusableClasses(rounds).of(last, path.without, path)
    others = _other_laws(rounds, last, classes)
    present = _with_fitted_law(rounds, _without_makeshifts(rounds, first, last, others), others)
    names = set(present.hypothesis.names)
    needed = {name: each for name, each in needed.items() if name in names}
    unsteady = tuple(name for name in names - others.keys() if _is_unsteady(rounds, present, name))
    unnamed = {*others, *unsteady}
    classes = {name: () if name in unnamed else group for name, group in classes.items() if name in names}
    return SearchResult(
        first, present, path.history, path.first_round, {}, needed, classes, other_laws=others, unsteady=unsteady
    )


def _without_makeshifts(
    rounds: ForwardSelection, first: Candidate, present: Candidate, others: Mapping[str, Candidate]
) -> Candidate:
    """Without effects that only make up for the wrong law of a force."""
    hypothesis = present.hypothesis
    for each in others.values():
        kept = set(rounds.pruned(first, each)[0].hypothesis.names)
        for name in present.hypothesis.names:
            if name not in kept | others.keys():
                hypothesis = hypothesis.minus(name)
    return present if hypothesis is present.hypothesis else rounds.validator.cross_validate(present, None, hypothesis)


def _with_fitted_law(rounds: ForwardSelection, present: Candidate, others: Mapping[str, Candidate]) -> Candidate:
    """In a world whose force has the fitted power: what is sought in contact must not make up for a wrong law.

    Of several such forces it is the one that reveals it most.
    """
    if not others:
        return present
    name, each = max(others.items(), key=lambda one: one[1].total)
    law, effects = power_law_of(each, name), present.hypothesis.effects
    base = law.at(present.hypothesis.base, each.hypothesis.values_of(law.name))
    values = tuple(each.hypothesis.values_of(effect.name) for effect in effects)
    return rounds.validator.cross_validate(present, None, Hypothesis(base, effects, values))


def power_law_of(candidate: Candidate, name: str) -> Effect:
    """The further power of a force in a hypothesis that has it.

    Args:
        candidate: The hypothesis.
        name: The effect whose force it is.
    """
    laws = (effect.other_power_law for effect in candidate.hypothesis.effects if effect.name == name)
    law = next(laws)
    assert law is not None
    return law


def _other_laws(
    rounds: ForwardSelection, present: Candidate, classes: Mapping[str, Sequence[Candidate]]
) -> dict[str, Candidate]:
    """Effects whose force clearly grows with another power of its state than theirs and their classes', with it."""
    out, validator = {}, rounds.validator
    for effect in present.hypothesis.effects:
        law, name = effect.other_power_law, effect.name
        if law is None:
            continue
        each = validator.cross_validate(present, law, present.hypothesis.plus(law))
        clear = each.p_value < rounds.level and each.total > 0
        clear = clear and all(validator.p_value_over(each, other) < rounds.level for other in classes.get(name, ()))
        if clear and abs(float(each.hypothesis.values_of(law.name)[0])) > rounds.settings.least_other_power:
            out[name] = each
    return out


def _is_unsteady(rounds: ForwardSelection, present: Candidate, name: str) -> bool:
    """Whether an effect is clearly not the same in all tosses."""
    over_noise, over_effect = present.fitted.scatter(name)
    settings = rounds.settings
    return over_noise > settings.scatter_over_noise and over_effect > settings.scatter_over_effect
