"""Confusable classes: what could stand in for each effect that was selected, with all others in.

What gained much in the round in which an effect joined is tried in its place. What is not clearly worse there is in its
confusable class.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

from tossid.diagnosis.selection.cross_validation import Candidate, CrossValidator
from tossid.diagnosis.selection.forward_selection import ForwardSelection, SelectionPath, deviance_closed
from tossid.diagnosis.selection.screening import screen
from tossid.physics.effects import Effect
from tossid.settings.diagnosis.diagnose import SelectionSettings


@dataclass(frozen=True)
class ConfusableClasses:
    """Comparisons of effects with those that could stand in for them.

    Attributes:
        rounds: Of forward selection, whose validator and levels they share.
    """

    rounds: ForwardSelection

    @property
    def _validator(self) -> CrossValidator:
        return self.rounds.validator

    @property
    def _settings(self) -> SelectionSettings:
        return self.rounds.settings

    def of(
        self, present: Candidate, without: Mapping[str, Candidate], path: SelectionPath
    ) -> tuple[dict[str, Candidate], dict[str, tuple[Candidate, ...]]]:
        """Each effect against the hypothesis without it, and what of its class could stand in for it.

        Args:
            present: The hypothesis.
            without: It without each of its effects, by name.
            path: How it was selected.

        Returns:
            Both by name of the effects that are not held.
        """
        needed, classes = {}, {}
        asked = [name for name in present.hypothesis.names if name not in self._validator.held]
        missing = [name for name in asked if name not in without]
        made = self._validator.map(partial(self.rounds.without, present), missing)
        without = {**without, **dict(zip(missing, made, strict=True))}
        for effect in present.hypothesis.effects:
            if effect.name in self._validator.held:
                continue
            gain = -without[effect.name].gain
            gains = self._validator.gains_of(effect.name, present.fitted, gain)
            needed[effect.name] = replace(present, effect=effect, gain=gain, toss_gains=gains)
            rivals = [each for each in path.classes.get(effect.name, ()) if each.name not in present.hypothesis.names]
            classes[effect.name] = self._stand_ins(without[effect.name], needed[effect.name], rivals, path.runners_up)
        return needed, classes

    def best_of_classes(self, present: Candidate, classes: Mapping[str, Sequence[Candidate]]) -> Candidate:
        """The hypothesis, or the one with another effect of a class in its effect's place that is clearly better.

        All are fitted from first states sought for each alone: states that have long followed one hypothesis hold the
        others back.

        Args:
            present: The hypothesis.
            classes: For each effect, the hypotheses with another in its place.
        """
        rivals = [(name, each) for name, group in classes.items() for each in group]
        if not rivals:
            return present
        own, *fitted = self._validator.map(self._refitted_afresh, [present, *(each for _, each in rivals)])
        best = own if self._validator.p_value_over(own, present) < self._settings.class_level else present
        ahead = [
            each
            for (name, rival), each in zip(rivals, fitted, strict=True)
            if self.is_better_instead(each, best, rival.effect, name)
        ]
        return max(ahead, key=lambda each: float(self._validator.gain_over(each, best).sum()), default=best)

    def _refitted_afresh(self, one: Candidate) -> Candidate:
        """A hypothesis refitted from first states that are sought for it alone."""
        begun = self._validator.evaluate(one.hypothesis)
        refits = self._validator.settings.cross_validation.refits
        return self.rounds.refitted(replace(one, fitted=begun.fitted), refits)

    def is_better_instead(self, one: Candidate, other: Candidate, effect: Effect | None, instead: str) -> bool:
        """Whether a hypothesis with an effect in place of another is clearly better.

        An effect that contains the other always fits as well, and so does a hypothesis with one effect more. They have
        to be better at the level of a new effect.

        Args:
            one: The hypothesis with the effect.
            other: The hypothesis with the other.
            effect: The effect.
            instead: The other's name.
        """
        more = len(one.hypothesis.effects) > len(other.hypothesis.effects)
        more = more or (effect is not None and instead in effect.contains)
        level = self.rounds.level if more else self._settings.class_level
        return self._validator.p_value_over(one, other) < level

    def clearly_best(self, group: Sequence[Candidate], hypotheses: Sequence[Candidate]) -> int:
        """Which member of a class it is whose hypothesis is clearly better than those of the members before it.

        Args:
            group: The members.
            hypotheses: With each of them in.
        """
        k_best = 0
        for k in range(1, len(group)):
            if self.is_better_instead(hypotheses[k], hypotheses[k_best], group[k].effect, group[k_best].name):
                k_best = k
        return k_best

    def _is_confusable(self, before: Candidate, best: Candidate, other: Candidate) -> bool:
        """Whether the tosses cannot distinguish `other` from `best`; a more general effect always fits as well."""
        validator, settings = self._validator, self._settings
        if other.effect is None or other is best or not other.total > max(0.0, settings.class_gain * best.total):
            return False
        if best.name in other.effect.contains:
            return validator.p_value_over(other, best) < settings.general_level
        closed, best_closed = (float(validator.by_toss(deviance_closed(before, each)).sum()) for each in (other, best))
        return closed > settings.class_closed * best_closed or (
            validator.p_value_over(best, other) > settings.class_level
        )

    def _stand_ins(
        self, without: Candidate, best: Candidate, others: Sequence[Effect], known: Sequence[Candidate]
    ) -> tuple[Candidate, ...]:
        """Which others could stand in for an effect, with all the rest in.

        Those that are `known` beside the same effects are taken as they were fitted.
        """
        beside = set(without.hypothesis.names)
        same = {each.name: each for each in known if set(each.hypothesis.names) == beside | {each.name}}

        def fitted(other: Effect) -> Candidate:
            return same.get(other.name) or self.rounds.fitted(without, screen(self._validator, without, other))

        out = [each for each in self._validator.map(fitted, others) if self._is_confusable(without, best, each)]
        out.sort(key=lambda each: -each.total)
        return tuple(out[: self._settings.largest_class - 1])
