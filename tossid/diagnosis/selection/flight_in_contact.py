"""What flight reveals, on all windows: contact decides between causes that do the same in flight."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

from tossid.diagnosis.likelihood.evidence import Hypothesis
from tossid.diagnosis.localisation.gap import share_left
from tossid.diagnosis.localisation.noise import noise_floor
from tossid.diagnosis.selection.confusable import ConfusableClasses
from tossid.diagnosis.selection.cross_validation import Candidate, CrossValidator
from tossid.diagnosis.selection.forward_selection import ForwardSelection
from tossid.diagnosis.selection.plausibility import implausible_alone
from tossid.diagnosis.selection.search_result import SearchResult, replaced
from tossid.diagnosis.under_way import UnderWay
from tossid.physics.effects import Effect
from tossid.types import Phase

Needed = dict[str, Candidate]
Classes = dict[str, tuple[Candidate, ...]]


@dataclass(frozen=True)
class Flown:
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
class FlightInContact:
    """Takes what flight reveals to all windows.

    Attributes:
        validator: Of all windows.
        library: The effects to choose from.
        first: The hypothesis without effects.
        under_way: Told what is known.
    """

    validator: CrossValidator
    library: Sequence[Effect]
    first: Candidate
    under_way: UnderWay

    @property
    def rounds(self) -> ForwardSelection:
        """Rounds in which nothing is held."""
        return ForwardSelection(self.validator, self.library, self.under_way)

    def with_contact_law(self, hypothesis: Hypothesis, flight: SearchResult | None) -> Hypothesis:
        """The hypothesis, with Coulomb's law in place of its relaxation if an effect of contact explains more under it.

        The relaxation lifts what slides, and so makes up for some of a missing bounce.

        Args:
            hypothesis: Without effects.
            flight: What flight reveals; None where there is none.
        """
        validator, relaxed = self.validator, hypothesis.base
        if relaxed.law.lifting == 0 or validator.engine.of_user or not self.rounds.can_name:
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
            significant = self.rounds.is_significant(rigid, rigid, each)
            if significant and validator.p_value_over(each, other) < self.rounds.level:
                return Hypothesis(base)
        return hypothesis

    def flown(self, hypothesis: Hypothesis, flight: SearchResult | None) -> Flown:
        """The effects that flight reveals, on all windows, from the hypothesis without effects on.

        Args:
            hypothesis: Without effects.
            flight: What flight reveals; None where there is none.
        """
        first = self._evaluated(hypothesis)
        history = [first]
        if flight is None or not flight.present.hypothesis.effects:
            return Flown(flight, history, {}, {})
        effects, values = flight.present.hypothesis.effects, flight.present.hypothesis.values
        for k in range(1, len(effects) + 1):
            history.append(self.validator.evaluate(Hypothesis(hypothesis.base, effects[:k], values[:k]), history[-1]))
        best, needed, classes = self.decided(history[-1], flight.needed, flight.classes)
        if any(classes.values()) and self.rounds.can_name:
            closed, _ = share_left(first, best, self.validator, noise_floor(self.validator.windows))
            if closed.value < self.validator.settings.verdict.all_closed:
                library = self.library_beside(Flown(flight, history, needed, classes))
                best, needed, classes = self._looking_ahead(first, best, needed, classes, library)
        history[-1] = self.rounds.refitted(best)
        self.under_way.reached(history[-1])
        return Flown(flight, history, needed, classes)

    def decided(
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
                k_best = ConfusableClasses(self.rounds).clearly_best([chosen, *rivals], evaluated)
                if k_best:
                    best = own = evaluated[k_best]
                    chosen = rivals[k_best - 1]
            needed[chosen.name] = chosen
            decided[chosen.name] = tuple(each for each in group if each is not chosen)
        return best, needed, decided

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
            As of `decided`.
        """
        n_flight = len(best.hypothesis.effects)

        def ahead(each: Candidate) -> Candidate:
            self.under_way("contact beside what flight cannot tell apart", 0.17)
            rounds = self.holding(each, n_flight, library)
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
                k_best = ConfusableClasses(self.rounds).clearly_best([chosen, *rivals], compared)
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

    def library_beside(self, flown: Flown) -> list[Effect]:
        """The effects that are sought in all windows.

        Args:
            flown: What flight reveals.
        """
        # what could stand in for an effect of flight is tried in its place, not beside it
        confusable = {each.name for group in flown.classes.values() for each in group}
        library = [effect for effect in self.library if effect.name not in confusable]
        if flown.result is not None and flown.result.unsteady:
            # beside a force that is not in the library, another effect of flight would only make up for it
            library = [effect for effect in library if Phase.FLIGHT not in effect.phases]
        return library

    def holding(self, present: Candidate, n_flight: int, library: Sequence[Effect]) -> ForwardSelection:
        """Rounds in which the first effects of a hypothesis, which flight has determined, are held.

        Args:
            present: The hypothesis.
            n_flight: How many effects that is.
            library: The effects to choose from.
        """
        held = frozenset(present.hypothesis.names[:n_flight])
        return ForwardSelection(replace(self.validator, held=held), library, self.under_way)

    def _evaluated(self, hypothesis: Hypothesis) -> Candidate:
        """A hypothesis at its values; the first one is known."""
        same = hypothesis.base is self.first.hypothesis.base and not hypothesis.effects
        return self.first if same else self.validator.evaluate(hypothesis)
