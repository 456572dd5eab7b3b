"""What a search for effects leaves."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

from tossid.diagnosis.findings import Interval
from tossid.diagnosis.likelihood.evidence import Hypothesis
from tossid.diagnosis.selection.cross_validation import Candidate


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
        saturated: Ranges of the sizes that tosses bound on one side only, by effect (`selection.saturation`).
        instead: In flight, the same with two effects in place of one that does there what they do together.
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
    saturated: dict[str, Interval] = field(default_factory=dict)
    instead: SearchResult | None = None

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
    def alternatives(self) -> tuple[Hypothesis, ...]:
        """The last hypothesis with one effect replaced by another of its class, for each of these."""
        last = self.present.hypothesis
        return tuple(replaced(last, name, each) for name, group in self.classes.items() for each in group)


def replaced(hypothesis: Hypothesis, name: str, other: Candidate) -> Hypothesis:
    """A hypothesis with the effect that a candidate added in the place of another.

    Args:
        hypothesis: The hypothesis.
        name: Of the effect that is replaced.
        other: The candidate.
    """
    assert other.effect is not None
    return hypothesis.with_instead(name, other.effect, other.hypothesis.values_of(other.name))
