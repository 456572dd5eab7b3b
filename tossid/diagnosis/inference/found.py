"""What a search has found, and what it has compared on the way."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from tossid.diagnosis.inference.evidence import Evidence
from tossid.diagnosis.inference.fitting import Fit
from tossid.diagnosis.inference.hypothesis import Hypothesis
from tossid.diagnosis.inference.sample import margin
from tossid.diagnosis.inference.screening import Candidate, Screening
from tossid.physics.effects import Effect

Array = NDArray[np.float64]

LAW = "law"
"""The family of `Effect.other_power_law`, which is no cause."""
LEAST_POWER = 0.5
"""Difference of a force's fitted power of its state to that of its law, from which the law is another."""


@dataclass(frozen=True)
class Fitted:
    """A candidate that was fitted, with the gain (n,) of each toss over the hypothesis before."""

    candidate: Candidate
    fit: Fit
    gain: Array


@dataclass(frozen=True)
class Round:
    """What a round has compared: the hypothesis before, the library beside it, and what was fitted, the best first."""

    before: Fit
    screening: Screening
    fitted: tuple[Fitted, ...]
    joined: Fitted | None

    @property
    def effect(self) -> Effect | None:
        """The effect that has joined; None if nothing has, or another law of contact."""
        return None if self.joined is None else self.joined.candidate.effect

    def __str__(self) -> str:
        """In lines."""
        screened = (f"{c.name} {c.total:.0f} (p {c.p_value:.3f})" for c in self.screening.candidates[:6])
        lines = [f"    {f.candidate.name} {f.gain.sum():.1f}: {words(f.fit.hypothesis)}" for f in self.fitted]
        end = "-> " + ("nothing" if self.joined is None else self.joined.candidate.name)
        return "\n".join(["screened " + ", ".join(screened), *lines, end])


@dataclass(frozen=True)
class Rival:
    """What could take an effect's place, with the gain (n,) of each toss over the hypothesis with that effect."""

    effect: Effect
    fit: Fit
    gain: Array

    @property
    def is_alike(self) -> bool:
        """Whether the tosses cannot tell both apart: it is behind by no more than the margin."""
        return bool(self.gain.sum() > -margin(self.gain))


@dataclass(frozen=True)
class Found:
    """What a search has found.

    Attributes:
        first: Evidence of the simulator as it is stated.
        fit: The hypothesis with all effects; those of contact are free.
        flight: The same in free flight alone, which determines the others; None where there is no flight.
        rounds: How it was chosen.
        needed: By an effect's name, the gain (n,) of each toss over the hypothesis without it.
        rivals: By an effect's name, what could take its place.
    """

    first: Evidence
    fit: Fit
    flight: Fit | None
    rounds: tuple[Round, ...]
    needed: Mapping[str, Array] = field(default_factory=dict)
    rivals: Mapping[str, tuple[Rival, ...]] = field(default_factory=dict)

    @property
    def hypothesis(self) -> Hypothesis:
        """With all effects."""
        return self.fit.hypothesis

    @property
    def rival_names(self) -> tuple[str, ...]:
        """Names of effects that could take the place of one."""
        return tuple(rival.effect.name for group in self.rivals.values() for rival in group)

    def alike(self, name: str) -> tuple[Rival, ...]:
        """Effects that the tosses cannot tell from one.

        Args:
            name: Of the effect.
        """
        return tuple(rival for rival in self.rivals.get(name, ()) if rival.is_alike)

    def fit_of(self, name: str) -> Fit:
        """The fit that has determined an effect's values.

        Args:
            name: Of the effect.
        """
        return self.flight if self.flight is not None and name in self.flown else self.fit

    def has_its_law(self, name: str) -> bool:
        """Whether an effect's force, if it is one, grows with its state as the effect's law says.

        Args:
            name: Of the effect.
        """
        h = self.hypothesis
        law = h.effect(name).other_power_law
        other = 0.0 if law is None or law.name not in h.names else float(h.values_of(law.name)[0])
        return h.effect(name).family != LAW and abs(other) < LEAST_POWER

    @property
    def flown(self) -> frozenset[str]:
        """Names of the effects that flight has determined."""
        return frozenset() if self.flight is None else frozenset(self.flight.hypothesis.names)


def words(hypothesis: Hypothesis) -> str:
    """A hypothesis in a line.

    Args:
        hypothesis: The hypothesis.
    """
    effects = (f"{effect.name} " + ", ".join(f"{x:.4g}" for x in values) for effect, values in hypothesis.items())
    return "; ".join([hypothesis.law.name, *effects])
