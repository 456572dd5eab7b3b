"""What a search for effects leaves."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

from tossid.diagnosis.findings import Interval
from tossid.diagnosis.likelihood.evidence import Hypothesis
from tossid.diagnosis.selection.cross_validation import Candidate, CrossValidator
from tossid.physics.effects import Effect

if TYPE_CHECKING:
    from tossid.diagnosis.localisation.refusal import Refuted


@dataclass(frozen=True)
class OtherCauses:
    """Causes that do in flight what found ones do, where contact does not decide between them.

    Attributes:
        candidate: The hypothesis with them in place of the found ones.
        needed: Each effect of it that flight reveals, against the hypothesis without this effect, as flight has it.
    """

    candidate: Candidate
    needed: Mapping[str, Candidate]


@dataclass(frozen=True)
class SearchResult:
    """The selected hypothesis, and how it was reached.

    Attributes:
        first: The hypothesis without effects.
        present: The hypothesis with all effects that joined and stayed.
        history: The hypotheses on the way, the first and the last among them.
        first_round: What the first round fitted, by name.
        flight_round: The same of free flight alone.
        needed: Each named effect against the hypothesis without it.
        classes: For each named effect, the hypotheses with another of its confusable class in its place.
        n_flight: How many of the effects, the first, were found in free flight.
        other_laws: Effects that stand in for a force of another law, each beside its fitted power of the state.
        unsteady: Effects that flight reveals, but not the same in all tosses.
        implausible: Effects whose intervals hold no change or touch a bound (`selection.plausibility`).
        begun_as_measured: Whether it is that of the search that began at what tosses say by themselves.
        refuted: Effects without which it was searched once more; None if there are none.
        saturated: Ranges of the sizes that tosses bound on one side only, by effect (`selection.saturation`).
        instead: In flight, the same with two effects in place of one that does there what they do together.
        other_causes: In all windows, causes that may be there instead of some that flight has revealed.
    """

    first: Candidate
    present: Candidate
    history: tuple[Candidate, ...]
    first_round: dict[str, Candidate]
    flight_round: dict[str, Candidate]
    needed: dict[str, Candidate]
    classes: dict[str, tuple[Candidate, ...]]
    n_flight: int = 0
    other_laws: dict[str, Candidate] = field(default_factory=dict)
    unsteady: tuple[str, ...] = ()
    implausible: tuple[str, ...] = ()
    begun_as_measured: bool = False
    refuted: Refuted | None = None
    saturated: dict[str, Interval] = field(default_factory=dict)
    instead: SearchResult | None = None
    other_causes: OtherCauses | None = None

    @property
    def unnamed(self) -> frozenset[str]:
        """Effects of the last hypothesis that only stand in for something else."""
        return frozenset((*self.other_laws, *self.unsteady, *self.implausible))

    def with_names(self, classes: dict[str, tuple[Candidate, ...]], implausible: tuple[str, ...]) -> SearchResult:
        """With other confusable classes, and effects that are no names.

        Args:
            classes: For each effect, the hypotheses with another in its place.
            implausible: Names of the effects that are none.
        """
        return replace(self, classes=classes, implausible=implausible)

    def ending_in(self, present: Candidate) -> SearchResult:
        """With another last hypothesis.

        Args:
            present: That hypothesis.
        """
        return replace(self, present=present, history=(*self.history[:-1], present))

    def without(self, name: str) -> SearchResult:
        """With nothing said of one effect.

        Args:
            name: Of the effect.
        """
        needed = {other: each for other, each in self.needed.items() if other != name}
        classes = {other: group for other, group in self.classes.items() if other != name}
        return replace(self, needed=needed, classes=classes)

    @property
    def exchanged(self) -> tuple[tuple[str, ...], tuple[str, ...]]:
        """Names of effects of the last hypothesis, and of the other causes that may be there instead of these."""
        other = self.other_causes
        if other is None:
            return (), ()
        names = self.present.hypothesis.names
        ours = tuple(name for name in names[: self.n_flight] if name not in other.needed)
        theirs = tuple(name for name in other.needed if name not in names)
        return (ours, theirs) if ours and theirs else ((), ())

    def stand_ins(self, name: str) -> tuple[Effect, ...]:
        """Effects that may be there instead of one, alone or together.

        Args:
            name: Of the effect, one of the last hypothesis.
        """
        ours, theirs = self.exchanged
        others = self.other_causes.candidate.hypothesis.effects if self.other_causes and name in ours else ()
        alone = {each.name: each.effect for each in self.classes.get(name, ()) if each.effect is not None}
        return tuple((alone | {each.name: each for each in others if each.name in theirs}).values())

    @property
    def alternatives(self) -> tuple[Hypothesis, ...]:
        """Hypotheses that may be right instead: with other causes, and with one effect replaced by one of its class."""
        last = self.present.hypothesis
        others = (self.other_causes.candidate.hypothesis,) if self.other_causes and any(self.exchanged) else ()
        return (*others, *(replaced(last, name, each) for name, group in self.classes.items() for each in group))


def replaced(hypothesis: Hypothesis, name: str, other: Candidate) -> Hypothesis:
    """A hypothesis with the effect that a candidate added in the place of another.

    Args:
        hypothesis: The hypothesis.
        name: Of the effect that is replaced.
        other: The candidate.
    """
    assert other.effect is not None
    return hypothesis.with_instead(name, other.effect, other.hypothesis.values_of(other.name))


def joined_one_by_one(validator: CrossValidator, history: Sequence[Candidate]) -> tuple[Candidate, ...]:
    """A history with a hypothesis for each effect, where several of them have joined at once.

    Args:
        validator: Of all windows.
        history: The hypotheses on the way, from that without effects on.

    Returns:
        The same ones. Before one with several effects more than its predecessor are those with one more of these at a
        time, at the same values.
    """
    out = [history[0]]
    for present in history[1:]:
        last, known = present.hypothesis, len(out[-1].hypothesis.effects)
        some = [Hypothesis(last.base, last.effects[:k], last.values[:k]) for k in range(known + 1, len(last.effects))]
        out += [*validator.map(validator.evaluate, some), present]
    return tuple(out)
