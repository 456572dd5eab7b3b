"""The search for effects: first in free flight alone, then in all windows.

What flight reveals is found and named there. Then it is in, and contact decides between effects of a confusable class,
and reveals what does not act in flight. The values that flight has determined are held in these rounds, but for a refit
of all whenever an effect has joined.

Where tosses contradict what the search has found and much of the gap is left, it begins once more in contact, at what
impacts and slides say by themselves (`localisation.witnesses`). Forward selection takes one effect at a time, and where
no hypothesis is near the noise it ends where it happens to go.

Where what was found has another effect in the place of one that tosses measure, and whole tosses are predicted better
with the measured one, the search is repeated without the other. Whole tosses decide between both answers.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from tossid.diagnosis.likelihood.evidence import Hypothesis
from tossid.diagnosis.localisation.contradictions import PredictiveCheck, stand_ins
from tossid.diagnosis.localisation.gap import share_left
from tossid.diagnosis.localisation.noise import noise_floor
from tossid.diagnosis.localisation.refusal import Growth, Refuted
from tossid.diagnosis.selection.confusable import ConfusableClasses
from tossid.diagnosis.selection.contact_law import under_other_impacts
from tossid.diagnosis.selection.cross_validation import Candidate, CrossValidator
from tossid.diagnosis.selection.flight_in_contact import FlightInContact, Flown
from tossid.diagnosis.selection.flight_search import search_flight
from tossid.diagnosis.selection.forward_selection import ForwardSelection, SelectionPath
from tossid.diagnosis.selection.search_result import OtherCauses, SearchResult, joined_one_by_one
from tossid.diagnosis.selection.two_causes import in_contact
from tossid.diagnosis.under_way import UnderWay
from tossid.physics.effects import Effect

Array = NDArray[np.float64]


def search(
    validator: CrossValidator,
    library: Sequence[Effect],
    first: Candidate,
    under_way: UnderWay,
    check: PredictiveCheck | None = None,
    law_is_known: bool = False,
) -> SearchResult:
    """The effects that tosses reveal, selected from a library.

    Args:
        validator: Of all windows.
        library: The effects to choose from.
        first: The hypothesis without effects.
        under_way: Told what is known.
        check: Of what was found, by what tosses show without a simulator; None for no check.
        law_is_known: Whether the law of impacts stays that of the hypothesis.
    """
    under_way("flight alone", 0.1)
    flight = search_flight(validator, library, first.hypothesis)
    return _Search(validator, library, first, under_way, check, law_is_known).run(flight)


@dataclass(frozen=True)
class _Search:
    """The search in all windows."""

    validator: CrossValidator
    library: Sequence[Effect]
    first: Candidate
    under_way: UnderWay
    check: PredictiveCheck | None = None
    law_is_known: bool = False

    @property
    def _flight(self) -> FlightInContact:
        """What takes that which flight reveals to all windows."""
        return FlightInContact(self.validator, self.library, self.first, self.under_way)

    @property
    def _rounds(self) -> ForwardSelection:
        """Rounds in which nothing is held."""
        return self._flight.rounds

    def run(self, flight: SearchResult | None) -> SearchResult:
        """From the hypothesis without effects to the selected one, given what flight reveals."""
        self.under_way("what flight reveals, in contact", 0.15)
        base = self.first.hypothesis.base if flight is None else flight.present.hypothesis.base
        hypothesis = self._flight.with_contact_law(Hypothesis(base), flight)
        flown, apart = self._flight.flown(hypothesis, flight), None
        if flight is not None and flight.instead is not None:
            apart = self._flight.flown(hypothesis, flight.instead)
            if self.validator.p_value_over(apart.history[-1], flown.history[-1]) < self._rounds.level:
                flown, apart = apart, None
        path, begun = self._in_contact(flown)
        chosen, refuted, asked = self, None, self._stand_ins(path.history[-1], flown.n_effects)
        if asked:
            self.under_way(f"again, without {', '.join(sorted(asked))}", 0.2)
            without = replace(self, library=[each for each in self.library if each.name not in asked])
            other, begun_too = without._in_contact(flown)
            refuted = self._refuted(path.history[-1], other.history[-1], asked)
            if refuted is not None:
                chosen, path, begun = without, replace(other, first_round=path.first_round), begun_too
        others = None
        if apart is not None:
            flown, path, others = chosen._with_two_causes(flown, apart, path)
        found = chosen._with_classes(flown, path)
        return replace(found, begun_as_measured=begun, other_causes=others, refuted=refuted)

    def _in_contact(self, flown: Flown) -> tuple[SelectionPath, bool]:
        """Rounds beside what flight reveals, and whether they began at what tosses say by themselves."""
        contact = self._beside(flown)
        path = self._under_the_law_of_impacts(flown, contact)
        first = path.history[0]
        path = contact.refit_until_stable(first, path)
        begun = self._begun_as_measured(path, flown.n_effects)
        if begun is None:
            return path, False
        other = contact.run(first, (*path.history[: flown.n_effects + 1], begun[0]), 0.2)
        other = contact.refit_until_stable(first, replace(other, classes={**begun[1], **other.classes}))
        if self.validator.p_value_over(other.history[-1], path.history[-1]) < self._rounds.level:
            return replace(other, first_round=path.first_round), True
        return path, False

    def _stand_ins(self, found: Candidate, n_flight: int) -> frozenset[str]:
        """Names of effects of contact in whose place what tosses measure predicts whole tosses better."""
        effects, library = found.hypothesis.effects[n_flight:], {effect.name: effect for effect in self.library}
        if self.check is None or not self._rounds.can_name or not stand_ins(library, effects):
            return frozenset()
        hypothesis, said = found.hypothesis, self.check.measured(found.hypothesis.world())
        places, asked = stand_ins(library.keys() & said.keys(), effects), set()
        if not places:
            return frozenset()
        errors = self.check.errors(hypothesis.world())
        for name, measured in places.items():
            instead = hypothesis.with_instead(name, library[measured], np.array([said[measured]]))
            if self._growth(errors, instead.clipped(instead.flat())).refused:
                asked.add(name)
        return frozenset(asked)

    def _refuted(self, found: Candidate, other: Candidate, names: frozenset[str]) -> Refuted | None:
        """Effects of a hypothesis that are refuted by another one without them.

        Windows are short. What predicts them best may do so with another motion after an impact than tosses have. So
        the other one must not be contradicted in what these effects stood in for, and predict whole tosses better.
        """
        assert self.check is not None
        effects = [effect for effect in found.hypothesis.effects if effect.name in names]
        if stand_ins(self.check.contradicted(other.hypothesis.world()), effects):
            return None
        growth = self._growth(self.check.errors(found.hypothesis.world()), other.hypothesis)
        return Refuted(tuple(sorted(names)), growth) if growth.refused else None

    def _growth(self, errors: Array, other: Hypothesis) -> Growth:
        """How much larger (n, 2) errors of whole tosses are than those under another hypothesis."""
        assert self.check is not None
        settings = self.validator.settings.verdict
        return Growth.of(errors, self.check.errors(other.world()), settings.refused_level, settings)

    def _with_two_causes(
        self, flown: Flown, apart: Flown, path: SelectionPath
    ) -> tuple[Flown, SelectionPath, OtherCauses | None]:
        """What flight reveals and the path, with two causes if contact prefers them; and what may be there instead."""
        self.under_way("two causes in place of one", 0.85)
        first, found = path.history[0], path.history[-1]
        asked = [replace(each.hypothesis, base=found.hypothesis.base) for each in apart.history[1:]]
        made = in_contact(self._beside(apart), first, found, asked[-1], flown.n_effects)
        if made is None:
            return flown, path, None
        other = None if made.decided else OtherCauses(made.other, (flown if made.two else apart).needed)
        if not made.two:
            return flown, path, other
        history = first, *self.validator.map(self.validator.evaluate, asked), made.chosen
        classes = {name: group for name, group in path.classes.items() if name in made.chosen.hypothesis.names}
        return apart, replace(path, history=history, classes=classes, runners_up=(), without={}), other

    def _under_the_law_of_impacts(self, flown: Flown, contact: ForwardSelection) -> SelectionPath:
        """Rounds from what flight reveals, which go on under the other law of impacts once the tosses show it.

        Args:
            flown: What flight reveals.
            contact: The rounds.

        Returns:
            How they went, from the hypothesis without effects under the law that they end with.
        """
        first, history = flown.history[0], flown.history
        shown: list[Candidate] = []

        def shows_other(present: Candidate) -> bool:
            if (other := under_other_impacts(self.validator, present)) is not None:
                shown.append(other)
            return bool(shown)

        if self.law_is_known:
            return contact.run(first, history, 0.2)
        path = contact.run(first, history, 0.2, until=shows_other)
        if not shown:
            return path
        before = (replace(each.hypothesis, base=shown[0].hypothesis.base) for each in path.history[:-1])
        first, *others = self.validator.map(self.validator.evaluate, before)
        present, without = contact.pruned(first, contact.refitted(shown[0]), thorough=False)
        self.under_way.reached(present, first)
        path = replace(path, history=(first, *others, present), runners_up=(), without=without)
        return path.then(contact.run(first, path.history, 0.4))

    def _with_classes(self, flown: Flown, path: SelectionPath) -> SearchResult:
        """What all windows reveal beside what flight does, and what could stand in for each effect.

        Args:
            flown: What flight reveals.
            path: How rounds in all windows went.
        """
        first, n_flight, needed, classes = path.history[0], flown.n_effects, flown.needed, flown.classes
        contact = self._flight.holding(path.history[-1], n_flight, self._flight.library_beside(flown))
        library, replacements = contact.library, self.validator.settings.selection.most_replacements
        while True:
            present = best = path.history[-1]
            self.under_way.reached(present)
            if replacements and len(present.hypothesis.effects) > n_flight:
                # with the effects of contact in, contact may decide what it could not before
                best, needed, classes = self._flight.decided(present, needed, classes, afresh=True)
            if best is present:
                self.under_way("what could stand in for each", 0.88)
                needed_too, classes_too = ConfusableClasses(contact).of(present, path.without, path)
                best = ConfusableClasses(contact).best_of_classes(present, classes_too) if replacements else present
            if best is present:
                break
            path, replacements = path.ending_in(best), replacements - 1
            contact = self._flight.holding(best, n_flight, library)
            path = contact.refit_until_stable(first, path)
        needed, flight = {**needed, **needed_too}, flown.result
        return SearchResult(
            first,
            present,
            joined_one_by_one(self.validator, path.history),
            path.first_round,
            {} if flight is None else flight.first_round,
            needed,
            {**classes, **classes_too},
            n_flight,
            {} if flight is None else {name: each for name, each in flight.other_laws.items() if name in needed},
            () if flight is None else tuple(name for name in flight.unsteady if name in needed),
        )

    def _begun_as_measured(
        self, path: SelectionPath, n_flight: int
    ) -> tuple[Candidate, dict[str, tuple[Effect, ...]]] | None:
        """What flight reveals, with effects at the values that tosses say by themselves, and what may replace each.

        None where tosses do not contradict what was found, or little of the gap is left.

        Args:
            path: Of forward selection from what flight reveals.
            n_flight: How many effects that is.
        """
        first, flown, found = path.history[0], path.history[n_flight], path.history[-1]
        closed, _ = share_left(first, found, self.validator, noise_floor(self.validator.windows))
        if self.check is None or not self._rounds.can_name or closed.value > self.validator.settings.verdict.all_closed:
            return None
        said = self.check.contradicted(found.hypothesis.world())
        hypothesis = flown.hypothesis
        for effect in self.library:
            if effect.name in said and effect.name not in hypothesis.names and len(effect.parameters) == 1:
                hypothesis = hypothesis.plus(effect, np.array([said[effect.name]]))
        if len(hypothesis.effects) == n_flight:
            return None
        self.under_way("again, from what impacts and slides say", 0.2)
        contact = self._flight.holding(flown, n_flight, self.library)
        begun = self.validator.evaluate(hypothesis.clipped(hypothesis.flat()))
        begun, without = contact.pruned(first, contact.refitted(begun))
        names = begun.hypothesis.names[n_flight:]
        if not names:
            return None
        self.under_way.reached(begun)
        return begun, {name: self._rivals(contact, without[name], name) for name in names}

    def _rivals(self, contact: ForwardSelection, without: Candidate, name: str) -> tuple[Effect, ...]:
        """What gains much by one step where an effect is left out: with all others in, they are fitted in its place."""
        promising = contact.promising(without)
        least = contact.settings.class_gain * promising[0].gain if promising else 0.0
        return tuple(each.effect for each in promising if each.effect.name != name and each.gain > least)

    def _beside(self, flown: Flown) -> ForwardSelection:
        """Rounds beside what flight has determined, which is held."""
        return self._flight.holding(flown.history[-1], flown.n_effects, self._flight.library_beside(flown))
