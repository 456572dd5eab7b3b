"""The search for effects: first in free flight alone, then in all windows.

What flight reveals is found and named there. Then it is in, and contact decides between effects of a confusable class,
and reveals what does not act in flight. The values that flight has determined are held in these rounds, but for a refit
of all whenever an effect has joined.

Where tosses contradict what the search has found and much of the gap is left, it begins once more in contact, at what
impacts and slides say by themselves (`localisation.witnesses`). Forward selection takes one effect at a time, and where
no hypothesis is near the noise it ends where it happens to go.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from tossid.diagnosis.likelihood.evidence import Hypothesis
from tossid.diagnosis.localisation.gap import share_left
from tossid.diagnosis.localisation.noise import noise_floor
from tossid.diagnosis.selection.confusable import ConfusableClasses
from tossid.diagnosis.selection.contact_law import under_other_impacts
from tossid.diagnosis.selection.cross_validation import Candidate, CrossValidator
from tossid.diagnosis.selection.flight_search import search_flight
from tossid.diagnosis.selection.forward_selection import ForwardSelection, SelectionPath
from tossid.diagnosis.selection.plausibility import implausible_alone
from tossid.diagnosis.selection.search_result import OtherCauses, SearchResult, joined_one_by_one, replaced
from tossid.diagnosis.selection.two_causes import in_contact
from tossid.diagnosis.under_way import UnderWay
from tossid.physics.effects import Effect, World
from tossid.types import Phase

Needed = dict[str, Candidate]
Classes = dict[str, tuple[Candidate, ...]]
Measured = Callable[[World], dict[str, float]]
"""What tosses say by themselves of the effects whose values in a world they contradict, by name."""


def search(
    validator: CrossValidator,
    library: Sequence[Effect],
    first: Candidate,
    under_way: UnderWay,
    measured: Measured = lambda world: {},
    law_is_known: bool = False,
) -> SearchResult:
    """The effects that tosses reveal, selected from a library.

    Args:
        validator: Of all windows.
        library: The effects to choose from.
        first: The hypothesis without effects.
        under_way: Told what is known.
        measured: What tosses say without a simulator.
        law_is_known: Whether the law of impacts stays that of the hypothesis.
    """
    under_way("flight alone", 0.1)
    flight = search_flight(validator, library, first.hypothesis)
    return _Search(validator, library, first, under_way, measured, law_is_known).run(flight)


@dataclass(frozen=True)
class _Flown:
    """What flight reveals, on all windows.

    Attributes:
        result: Of the search in flight; None where there is none.
        history: The hypotheses on the way, from that without effects on.
        needed: Each effect against the hypothesis without it, as flight has it.
        classes: The confusable classes, as contact has ordered them.
    """

    result: SearchResult | None
    history: Sequence[Candidate]
    needed: Needed
    classes: Classes

    @property
    def n_effects(self) -> int:
        """How many effects flight reveals."""
        return len(self.history) - 1


@dataclass(frozen=True)
class _Search:
    """The search in all windows."""

    validator: CrossValidator
    library: Sequence[Effect]
    first: Candidate
    under_way: UnderWay
    measured: Measured
    law_is_known: bool = False

    @property
    def _rounds(self) -> ForwardSelection:
        """Rounds in which nothing is held."""
        return ForwardSelection(self.validator, self.library, self.under_way)

    def run(self, flight: SearchResult | None) -> SearchResult:
        """From the hypothesis without effects to the selected one, given what flight reveals."""
        self.under_way("what flight reveals, in contact", 0.15)
        base = self.first.hypothesis.base if flight is None else flight.present.hypothesis.base
        hypothesis = self._with_contact_law(Hypothesis(base), flight)
        flown, apart = self._with_flight(hypothesis, flight), None
        if flight is not None and flight.instead is not None:
            apart = self._with_flight(hypothesis, flight.instead)
            if self.validator.p_value_over(apart.history[-1], flown.history[-1]) < self._rounds.level:
                flown, apart = apart, None
        contact = self._beside(flown)
        path = self._under_the_law_of_impacts(flown, contact)
        first = path.history[0]
        path = contact.refit_until_stable(first, path)
        begun = self._begun_as_measured(path, flown.n_effects)
        better, others = False, None
        if begun is not None:
            other = contact.run(first, (*path.history[: flown.n_effects + 1], begun[0]), 0.2)
            other = contact.refit_until_stable(first, replace(other, classes={**begun[1], **other.classes}))
            better = self.validator.p_value_over(other.history[-1], path.history[-1]) < self._rounds.level
            path = replace(other, first_round=path.first_round) if better else path
        if apart is not None:
            flown, path, others = self._with_two_causes(flown, apart, path)
        return replace(self._with_classes(flown, path), begun_as_measured=better, other_causes=others)

    def _with_two_causes(
        self, flown: _Flown, apart: _Flown, path: SelectionPath
    ) -> tuple[_Flown, SelectionPath, OtherCauses | None]:
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

    def _under_the_law_of_impacts(self, flown: _Flown, contact: ForwardSelection) -> SelectionPath:
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

    def _with_classes(self, flown: _Flown, path: SelectionPath) -> SearchResult:
        """What all windows reveal beside what flight does, and what could stand in for each effect.

        Args:
            flown: What flight reveals.
            path: How rounds in all windows went.
        """
        first, n_flight, needed, classes = path.history[0], flown.n_effects, flown.needed, flown.classes
        contact = self._holding(path.history[-1], n_flight, self._library_beside(flown))
        library, replacements = contact.library, self.validator.settings.selection.most_replacements
        while True:
            present = best = path.history[-1]
            self.under_way.reached(present)
            if replacements and len(present.hypothesis.effects) > n_flight:
                # with the effects of contact in, contact may decide what it could not before
                best, needed, classes = self._decided_by_contact(present, needed, classes, afresh=True)
            if best is present:
                self.under_way("what could stand in for each", 0.88)
                needed_too, classes_too = ConfusableClasses(contact).of(present, path.without, path)
                best = ConfusableClasses(contact).best_of_classes(present, classes_too) if replacements else present
            if best is present:
                break
            path, replacements = path.ending_in(best), replacements - 1
            contact = self._holding(best, n_flight, library)
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
        if not self._rounds.can_name or closed.value > self.validator.settings.verdict.all_closed:
            return None
        said = self.measured(found.hypothesis.world())
        hypothesis = flown.hypothesis
        for effect in self.library:
            if effect.name in said and effect.name not in hypothesis.names and len(effect.parameters) == 1:
                hypothesis = hypothesis.plus(effect, np.array([said[effect.name]]))
        if len(hypothesis.effects) == n_flight:
            return None
        self.under_way("again, from what impacts and slides say", 0.2)
        contact = self._holding(flown, n_flight, self.library)
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

    def _with_flight(self, hypothesis: Hypothesis, flight: SearchResult | None) -> _Flown:
        """The effects that flight reveals, on all windows, from the hypothesis without effects on."""
        first = self._evaluated(hypothesis)
        history = [first]
        if flight is None or not flight.present.hypothesis.effects:
            return _Flown(flight, history, {}, {})
        effects, values = flight.present.hypothesis.effects, flight.present.hypothesis.values
        for k in range(1, len(effects) + 1):
            history.append(self.validator.evaluate(Hypothesis(hypothesis.base, effects[:k], values[:k]), history[-1]))
        best, needed, classes = self._decided_by_contact(history[-1], flight.needed, flight.classes)
        if any(classes.values()) and self._rounds.can_name:
            closed, _ = share_left(first, best, self.validator, noise_floor(self.validator.windows))
            if closed.value < self.validator.settings.verdict.all_closed:
                library = self._library_beside(_Flown(flight, history, needed, classes))
                best, needed, classes = self._looking_ahead(first, best, needed, classes, library)
        history[-1] = self._rounds.refitted(best)
        self.under_way.reached(history[-1])
        return _Flown(flight, history, needed, classes)

    def _looking_ahead(
        self, first: Candidate, best: Candidate, needed: Needed, classes: Classes, library: Sequence[Effect]
    ) -> tuple[Candidate, Needed, Classes]:
        """What flight cannot distinguish, decided with the most promising effect of contact beside each alternative.

        While contact is not explained, the wrong alternative may fit it better by chance. Then the effects that would
        explain contact are not found beside it.

        Args:
            first: The hypothesis without effects.
            best: The hypothesis.
            needed: Each effect of flight against the hypothesis without it.
            classes: The confusable classes of these.
            library: The effects that are sought beside them.

        Returns:
            As of `_decided_by_contact`.
        """
        n_flight = len(best.hypothesis.effects)

        def ahead(each: Candidate) -> Candidate:
            self.under_way("contact beside what flight cannot tell apart", 0.17)
            rounds = self._holding(each, n_flight, library)
            fitted = [rounds.fitted(each, one) for one in rounds.promising(each)[:1]]
            return next((one for one in fitted if rounds.is_significant(first, each, one)), each)

        needed, decided = dict(needed), {}
        for name, others in classes.items():
            rivals, chosen = self._may_lead(others), needed.pop(name)
            group = chosen, *others
            if rivals:
                asked = [replaced(best.hypothesis, name, other) for other in rivals]
                evaluated = [best, *self.validator.map(partial(self.validator.evaluate, near=best), asked)]
                compared = self.validator.map(ahead, evaluated)
                k_best = ConfusableClasses(self._rounds).clearly_best([chosen, *rivals], compared)
                best, chosen = evaluated[k_best], [chosen, *rivals][k_best]
            needed[chosen.name] = chosen
            decided[chosen.name] = tuple(each for each in group if each is not chosen)
        return best, needed, decided

    def _may_lead(self, group: Sequence[Candidate]) -> list[Candidate]:
        """Which members of a class flight alone gives a name.

        Others, such as a force whose law is more general than flight can tell, would make up for what is missing in
        contact.
        """
        return [each for each in group if implausible_alone(each, self.validator.n) is None]

    def _evaluated(self, hypothesis: Hypothesis) -> Candidate:
        """A hypothesis at its values; the first one is known."""
        same = hypothesis.base is self.first.hypothesis.base and not hypothesis.effects
        return self.first if same else self.validator.evaluate(hypothesis)

    def _library_beside(self, flown: _Flown) -> list[Effect]:
        """The effects that are sought in all windows."""
        # what could stand in for an effect of flight is tried in its place, not beside it
        confusable = {each.name for group in flown.classes.values() for each in group}
        library = [effect for effect in self.library if effect.name not in confusable]
        if flown.result is not None and flown.result.unsteady:
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

    def _beside(self, flown: _Flown) -> ForwardSelection:
        """Rounds beside what flight has determined, which is held."""
        return self._holding(flown.history[-1], flown.n_effects, self._library_beside(flown))

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
            rivals, chosen = self._may_lead(others), needed.pop(name)
            group = chosen, *others
            if rivals:
                own = own or validator.evaluate(best.hypothesis, near)
                asked = [replaced(best.hypothesis, name, other) for other in rivals]
                evaluated = [own, *validator.map(partial(validator.evaluate, near=near), asked)]
                k_best = ConfusableClasses(self._rounds).clearly_best([chosen, *rivals], evaluated)
                if k_best:
                    best = own = evaluated[k_best]
                    chosen = rivals[k_best - 1]
            needed[chosen.name] = chosen
            decided[chosen.name] = tuple(each for each in group if each is not chosen)
        return best, needed, decided
