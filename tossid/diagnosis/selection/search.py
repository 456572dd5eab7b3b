"""The search for effects: first in free flight alone, then in all windows.

What flight reveals is found and named there. Then it is in, and contact decides between effects of a confusable class,
and reveals what does not act in flight. The values that flight has determined are held in these rounds, but for a refit
of all whenever an effect has joined.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

from tossid.diagnosis.likelihood.evidence import Hypothesis
from tossid.diagnosis.selection.cross_validation import Candidate, CrossValidator
from tossid.diagnosis.selection.flight_search import search_flight
from tossid.diagnosis.selection.forward_selection import ForwardSelection
from tossid.diagnosis.selection.search_result import SearchResult, replaced
from tossid.diagnosis.under_way import UnderWay
from tossid.physics.effects import Effect
from tossid.types import Phase

Needed = dict[str, Candidate]
Classes = dict[str, tuple[Candidate, ...]]


def search(validator: CrossValidator, library: Sequence[Effect], first: Candidate, under_way: UnderWay) -> SearchResult:
    """The effects that tosses reveal, selected from a library.

    Args:
        validator: Of all windows.
        library: The effects to choose from.
        first: The hypothesis without effects.
        under_way: Told what is known.
    """
    under_way("flight alone", 0.1)
    flight = search_flight(validator, library, first.hypothesis)
    return _Search(validator, library, first, under_way).run(flight)


@dataclass(frozen=True)
class _Search:
    """The search in all windows."""

    validator: CrossValidator
    library: Sequence[Effect]
    first: Candidate
    under_way: UnderWay

    @property
    def _rounds(self) -> ForwardSelection:
        """Rounds in which nothing is held."""
        return ForwardSelection(self.validator, self.library, self.under_way)

    def run(self, flight: SearchResult | None) -> SearchResult:
        """From the hypothesis without effects to the selected one, given what flight reveals."""
        self.under_way("what flight reveals, in contact", 0.15)
        base = self.first.hypothesis.base if flight is None else flight.present.hypothesis.base
        hypothesis = self._with_contact_law(Hypothesis(base), flight)
        first, history, needed, classes = self._with_flight(hypothesis, flight)
        n_flight = len(history[-1].hypothesis.effects)
        library = self._library_beside(flight, classes)
        contact = self._holding(history[-1], n_flight, library)
        path = contact.run(first, history, 0.2)
        replacements = self.validator.settings.selection.most_replacements
        while True:
            path = contact.refit_until_stable(first, path)
            present = best = path.history[-1]
            self.under_way.reached(present)
            if replacements and len(present.hypothesis.effects) > n_flight:
                # with the effects of contact in, contact may decide what it could not before
                best, needed, classes = self._decided_by_contact(present, needed, classes, afresh=True)
            if best is present:
                self.under_way("what could stand in for each", 0.88)
                needed_too, classes_too = contact.confusable_classes(present, path.without, path)
                best = contact.best_of_classes(present, classes_too) if replacements else present
            if best is present:
                break
            path, replacements = path.ending_in(best), replacements - 1
            contact = self._holding(best, n_flight, library)
        needed = {**needed, **needed_too}
        return SearchResult(
            first,
            present,
            path.history,
            path.first_round,
            {} if flight is None else flight.first_round,
            needed,
            {**classes, **classes_too},
            n_flight,
            {} if flight is None else {name: each for name, each in flight.other_laws.items() if name in needed},
            () if flight is None else tuple(name for name in flight.unsteady if name in needed),
        )

    def _with_flight(
        self, hypothesis: Hypothesis, flight: SearchResult | None
    ) -> tuple[Candidate, list[Candidate], Needed, Classes]:
        """The hypothesis on all windows without effects, and a history to it with the effects that flight reveals."""
        first = self._evaluated(hypothesis)
        history = [first]
        if flight is None or not flight.present.hypothesis.effects:
            return first, history, {}, {}
        effects, values = flight.present.hypothesis.effects, flight.present.hypothesis.values
        for k in range(1, len(effects) + 1):
            history.append(self.validator.evaluate(Hypothesis(hypothesis.base, effects[:k], values[:k]), history[-1]))
        best, needed, classes = self._decided_by_contact(history[-1], flight.needed, flight.classes)
        history[-1] = self._rounds.refitted(best)
        self.under_way.reached(history[-1])
        return first, history, needed, classes

    def _evaluated(self, hypothesis: Hypothesis) -> Candidate:
        """A hypothesis at its values; the first one is known."""
        same = hypothesis.base is self.first.hypothesis.base and not hypothesis.effects
        return self.first if same else self.validator.evaluate(hypothesis)

    def _library_beside(self, flight: SearchResult | None, classes: Classes) -> list[Effect]:
        """The effects that are sought in all windows."""
        # what could stand in for an effect of flight is tried in its place, not beside it
        confusable = {each.name for group in classes.values() for each in group}
        library = [effect for effect in self.library if effect.name not in confusable]
        if flight is not None and flight.unsteady:
            # beside a force that is not in the library, another effect of flight would only make up for it
            library = [effect for effect in library if Phase.FLIGHT not in effect.phases]
        return library

    def _with_contact_law(self, hypothesis: Hypothesis, flight: SearchResult | None) -> Hypothesis:
        """The hypothesis, with Coulomb's law in place of its relaxation if an effect of contact explains more under it.

        The relaxation lifts what slides, and so makes up for some of a missing bounce.
        """
        validator, relaxed = self.validator, hypothesis.base
        if relaxed.law.lifting == 0 or validator.engine.of_user or not self._rounds.can_name:
            return hypothesis
        base = replace(relaxed, law=relaxed.law._replace(lifting=0.0))
        found = Hypothesis(relaxed) if flight is None else flight.present.hypothesis
        other = self._evaluated(Hypothesis(relaxed, found.effects, found.values))
        self.under_way("Coulomb's law", 0.16)
        held = replace(validator, held=frozenset(found.names))
        in_contact = [effect for effect in self.library if Phase.FLIGHT not in effect.phases]
        rounds = ForwardSelection(held, in_contact, self.under_way)
        rigid = validator.evaluate(Hypothesis(base, found.effects, found.values))
        least = validator.settings.selection.coulomb_gain * float(validator.gain_over(other, rigid).sum())
        for each in rounds.round(rigid, rigid, least):
            significant = self._rounds.is_significant(rigid, rigid, each)
            if significant and validator.p_value_over(each, other) < self._rounds.level:
                return Hypothesis(base)
        return hypothesis

    def _holding(self, present: Candidate, n_flight: int, library: Sequence[Effect]) -> ForwardSelection:
        """Rounds in which the first effects of a hypothesis, which flight has determined, are held."""
        held = frozenset(present.hypothesis.names[:n_flight])
        return ForwardSelection(replace(self.validator, held=held), library, self.under_way)

    def _decided_by_contact(
        self,
        best: Candidate,
        needed: Mapping[str, Candidate],
        classes: Mapping[str, Sequence[Candidate]],
        *,
        afresh: bool = False,
    ) -> tuple[Candidate, Needed, Classes]:
        """A hypothesis on all windows in which contact has decided, where it can, what flight cannot distinguish.

        Args:
            best: The hypothesis.
            needed: Each effect against the hypothesis without it, as flight has it.
            classes: The confusable classes, as flight has them.
            afresh: Whether first states are sought for each hypothesis alone, and not only near the best one's.

        Returns:
            The hypothesis, and the two others with the effects that it has.
        """
        validator, needed, decided = self.validator, dict(needed), {}
        near, own = None if afresh else best, None
        for name, others in classes.items():
            group, k_best = [needed.pop(name), *others], 0
            if others:
                own = own or validator.evaluate(best.hypothesis, near)
                asked = [replaced(best.hypothesis, name, other) for other in others]
                evaluated = [own, *validator.map(partial(validator.evaluate, near=near), asked)]
                for k in range(1, len(evaluated)):
                    effect, instead = group[k].effect, group[k_best].name
                    if self._rounds.is_better_instead(evaluated[k], evaluated[k_best], effect, instead):
                        k_best = k
                if k_best:
                    best = own = evaluated[k_best]
            chosen = group[k_best]
            needed[chosen.name] = chosen
            decided[chosen.name] = tuple(each for each in group if each is not chosen)
        return best, needed, decided
