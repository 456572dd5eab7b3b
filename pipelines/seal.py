"""What is wrong with the demo's simulator: drawn, sealed by its hash, and opened beside what was found."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from tossid.objects import GRAVITY

WITHIN = 0.1
"""Share of the true change by which the found one may be off: a demo succeeds where it names the effect, no other, and
comes so near."""


class Kind(NamedTuple):
    """An effect that may be wrong, its parameter, that one's value in cube.xml, and ranges in which the truth lies."""

    parameter: str
    stated: float
    ranges: tuple[tuple[float, float], ...]


KINDS = {
    "friction": Kind("mu", 0.18, ((0.26, 0.40),)),
    "com_offset": Kind("z_m", 0.0, ((-0.006, -0.003), (0.003, 0.006))),
    "inertia": Kind("scale_rel", 1.0, ((1.2, 1.5),)),
    "gravity": Kind("g_ms2", GRAVITY, ((9.2, 9.55), (10.1, 10.4))),
}
"""What may be wrong, by the effect's name."""


@dataclass(frozen=True)
class Sealed:
    """What is wrong with the simulator, and the salt that keeps its hash from being guessed."""

    effect: str
    parameter: str
    value: float
    salt: str

    @staticmethod
    def drawn(seed: int) -> Sealed:
        """A difference drawn at random.

        Args:
            seed: Of the draw.
        """
        rng = np.random.default_rng([seed, 41])
        effect = str(rng.choice(list(KINDS)))
        parameter, _, ranges = KINDS[effect]
        low, high = ranges[rng.integers(len(ranges))]
        return Sealed(effect, parameter, round(float(rng.uniform(low, high)), 4), rng.bytes(8).hex())

    @property
    def text(self) -> str:
        """What is hashed."""
        return json.dumps(vars(self), sort_keys=True)

    @property
    def sha256(self) -> str:
        """Its hash, which is printed before anything else."""
        return hashlib.sha256(self.text.encode()).hexdigest()


@dataclass(frozen=True)
class Opened:
    """A seal beside what was found.

    Attributes:
        sealed: The truth.
        named: The effects that were named, in the order in which they matter.
        value: Of the sealed parameter, as found; None where its effect was not named.
        ci95: Its 95 % interval.
    """

    sealed: Sealed
    named: tuple[str, ...]
    value: float | None = None
    ci95: tuple[float, float] = (np.nan, np.nan)

    @staticmethod
    def of(sealed: Sealed, gap: Mapping[str, Any]) -> Opened:
        """The seal opened.

        Args:
            sealed: What is wrong.
            gap: The content of gap.json.
        """
        named = tuple(gap["explanation"]["effects"])
        for effect in gap["effects"]:
            known = effect["parameters"].get(sealed.parameter)
            if effect["name"] == sealed.effect and sealed.effect in named and known is not None:
                return Opened(sealed, named, known["value"], tuple(known["ci95"]))
        return Opened(sealed, named)

    @property
    def right(self) -> bool:
        """Whether the sealed effect was named, no other, and its change is right to within `WITHIN` of it."""
        if self.value is None or self.named != (self.sealed.effect,):
            return False
        change = self.sealed.value - KINDS[self.sealed.effect].stated
        return abs(self.value - self.sealed.value) <= WITHIN * abs(change)

    @property
    def row(self) -> list[str]:
        """The sealed effect, its value in cube.xml, its true one, and what was found, as a person reads them."""
        from tossid.diagnosis.findings import Interval
        from tossid.diagnosis.report.units import in_units, parameter, quantity

        key, kind = self.sealed.parameter, KINDS[self.sealed.effect]
        head = f"{self.sealed.effect} {parameter(key)}"
        if self.value is None:
            found = f"not named; {', '.join(self.named) or 'nothing'} instead"
        else:
            found = in_units(key, Interval(self.value, *self.ci95))
            others = [name for name in self.named if name != self.sealed.effect]
            found += f"; besides {', '.join(others)}" if others else ""
        return [head, quantity(key, kind.stated), quantity(key, self.sealed.value), found]


def judgement(seal: Opened) -> str:
    """Whether the demo succeeded, in a sentence."""
    if seal.right:
        return "Named, and nothing else."
    if seal.value is None:
        return "Missed: the effect was not named. docs/results/demo.md says how often that happens."
    return f"Named, but not as it should be: with others, or off by more than {100 * WITHIN:.0f} % of the change."
