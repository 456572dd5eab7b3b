"""One effect that does in flight what two others do together, and contact that decides between them.

Where lengths are recorded too short, and the recorded world is tilted, an object falls as under a constant force. That
is one effect for two, so forward selection prefers it. But in contact it needs another size and a tilted ground beside
it, and they need nothing. So contact has to decide: before effects of contact are sought, and once more with these in.
Where it leaves much of the gap either way, it does not decide, and both are stated.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from tossid.diagnosis.likelihood.evidence import Hypothesis
from tossid.diagnosis.localisation.gap import share_left
from tossid.diagnosis.localisation.noise import noise_floor
from tossid.diagnosis.selection.cross_validation import Candidate, CrossValidator
from tossid.diagnosis.selection.forward_selection import ForwardSelection, SelectionPath
from tossid.physics.effects import Effect

Array = NDArray[np.float64]


def with_two_causes(rounds: ForwardSelection, path: SelectionPath) -> SelectionPath | None:
    """A path in flight with two effects in place of one; None if no two do as well with no more parameters.

    Args:
        rounds: In flight.
        path: How they went.

    Returns:
        The path that ends with the two, each with what could stand in for it beside the other.
    """
    last, validator = path.history[-1], rounds.validator
    for effect in last.hypothesis.effects:
        pairs = _pairs(rounds, path.history[0], last, effect) if effect.contains else []
        if not pairs:
            continue
        best, *others = sorted(pairs, key=lambda each: -validator.by_toss(each.log_likelihood).sum())
        classes = {name: group for name, group in path.classes.items() if name != effect.name}
        for name in [each for each in best.hypothesis.names if each not in last.hypothesis.names]:
            beside = {*best.hypothesis.names} - {name}
            classes[name] = tuple(
                next(each for each in pair.hypothesis.effects if each.name not in beside)
                for pair in others
                if beside < {*pair.hypothesis.names}
            )
        return replace(path, history=(*path.history[:-1], best), classes=classes, runners_up=(), without={})
    return None


def _pairs(rounds: ForwardSelection, first: Candidate, last: Candidate, effect: Effect) -> list[Candidate]:
    """Hypotheses of flight with two significant effects in place of one, and not clearly worse.

    Args:
        rounds: In flight.
        first: The hypothesis without effects.
        last: With the one effect.
        effect: That effect.
    """
    size, level = len(effect.parameters), rounds.settings.class_level
    pairs: dict[frozenset[str], Candidate] = {}
    without = rounds.without(last, effect.name)
    for one in _beside(rounds, first, without, size - 1)[: rounds.settings.largest_class]:
        assert one.effect is not None
        for two in _beside(rounds, first, one, size - len(one.effect.parameters)):
            if rounds.validator.p_value_over(last, two) > level:
                pairs.setdefault(frozenset(two.hypothesis.names), two)
    return list(pairs.values())


def _beside(rounds: ForwardSelection, first: Candidate, present: Candidate, size: int) -> list[Candidate]:
    """The significant effects of at most so many parameters beside a hypothesis, those that gain most first."""
    small = [each for each in rounds.promising(present) if len(each.effect.parameters) <= size]
    fitted = rounds.validator.map(partial(rounds.fitted, present), small)
    significant = [each for each in fitted if rounds.is_significant(first, present, each)]
    return sorted(significant, key=lambda each: -each.total)


@dataclass(frozen=True)
class InContact:
    """What contact makes of one cause, and of two that do the same in flight.

    Attributes:
        chosen: The hypothesis that stands.
        other: The other one.
        two: Whether that which stands has the two causes.
        decided: Whether contact tells them apart.
    """

    chosen: Candidate
    other: Candidate
    two: bool
    decided: bool


def in_contact(
    rounds: ForwardSelection, first: Candidate, found: Candidate, flown: Hypothesis, n_flight: int
) -> InContact | None:
    """One cause with effects of contact, or two in its place with fewer; None if two always have more parameters.

    Some of the effects that were found beside the one cause have made up for what the two explain. Those that are
    needed least leave until there are fewer parameters than before. What has more of them must be better at the level
    of a new effect. Both are fitted from first states that are sought for them alone.

    Args:
        rounds: In all windows, in which the two causes are held.
        first: The hypothesis without effects.
        found: The hypothesis with the one cause, and with effects of contact.
        flown: What flight reveals, the two causes among it.
        n_flight: How many effects of the hypothesis, the first, flight has revealed.
    """
    validator, hypothesis = rounds.validator, flown
    refits = validator.settings.cross_validation.refits
    for effect in found.hypothesis.effects[n_flight:]:
        hypothesis = hypothesis.plus(effect, _beside_tilts(effect, found.hypothesis, flown))
    asked = [found.hypothesis, hypothesis.clipped(hypothesis.flat())]
    again, present = validator.map(validator.evaluate, asked)
    while len(present.hypothesis.flat()) >= len(found.hypothesis.flat()):
        names = present.hypothesis.names[len(flown.effects) :]
        if not names:
            return None
        near = partial(validator.evaluate, near=present)
        tried = validator.map(near, [present.hypothesis.minus(name) for name in names])
        present = max(tried, key=lambda each: float(validator.by_toss(validator.gain_over(each, present)).sum()))
    again, present = validator.map(lambda each: rounds.refitted(each, refits), [again, present])
    if validator.p_value_over(again, present) < rounds.level:
        return InContact(again, present, False, _decides(validator, first, again, present))
    decided = _decides(validator, first, present, again)
    return InContact(rounds.pruned(first, present, thorough=False)[0], again, True, decided)


def _decides(validator: CrossValidator, first: Candidate, chosen: Candidate, other: Candidate) -> bool:
    """Whether contact tells two hypotheses apart that are alike in flight.

    The other is clearly worse, and the chosen one closes the gap, or the other clearly less of it. Where contact is not
    modelled, what is clearly worse may be right.
    """
    settings, floor = validator.settings, noise_floor(validator.windows)
    closed, by_other = (share_left(first, each, validator, floor)[0].value for each in (chosen, other))
    enough = closed >= settings.verdict.all_closed or by_other < settings.selection.class_closed * closed
    return enough and validator.p_value_over(chosen, other) < settings.selection.class_level


def _beside_tilts(effect: Effect, found: Hypothesis, flown: Hypothesis) -> Array:
    """An effect's values beside the two causes: the ground is tilted by so much less as the whole world is by now."""
    values = found.values_of(effect.name)
    group = effect.one_of_group - set(found.names)
    for each in flown.effects:
        if each.name in group and len(each.parameters) == len(values):
            values = values - flown.values_of(each.name)
    return np.asarray(values)
