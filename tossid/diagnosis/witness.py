"""What a witness of an effect says, beside what a diagnosis found."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from tossid.diagnosis.findings import Interval


@dataclass(frozen=True)
class Witness:
    """A quantity that tosses reveal without a simulator (`localisation.witnesses`).

    Attributes:
        quantity: In words.
        effect: Name of the effect of which it speaks.
        stated: Its value in the stated simulator.
        found: Its value with the effects that the diagnosis found.
        measured: Its value in the tosses.
        tosses: How many reveal it.
        predicted: Its value in tosses that the simulator with these effects makes, measured alike, so that what biases
            the measurement biases both. None where too few of them reveal it, or none were made.
        contradicts: Whether the tosses clearly have another value than those made tosses.
    """

    quantity: str
    effect: str
    stated: float
    found: float
    measured: Interval
    tosses: int
    predicted: Interval | None = None
    contradicts: bool = False

    def as_json(self) -> dict[str, Any]:
        """One of gap.json's "witnesses"."""
        return {
            "quantity": self.quantity,
            "effect": self.effect,
            "stated": self.stated,
            "found": self.found,
            "measured": self.measured.as_json(),
            "tosses": self.tosses,
            "predicted": None if self.predicted is None else self.predicted.as_json(),
            "contradicts": self.contradicts,
        }
