"""Significance over tosses: signed ranks, several tests of the same effect, and how many tosses both need.

Signed ranks of n tosses have no smaller p-value than 2^-n, when all gain. With k tests of an effect and L effects in a
library (Bonferroni over both), an effect can be significant at a level only if k L 2^-n is below that level.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats import rankdata, wilcoxon

from tossid.physics.effects import Effect
from tossid.types import Phase

Array = NDArray[np.float64]

PARTS = 3
"""Tests of an effect in all windows: of all of them, of those with an impact, and of the others with contact."""
_FEWEST_RANKS = 3
"""Values from which signed ranks are tested."""
_MOST_EXACT = 50
"""Values up to which the distribution of their signed ranks is exact, and beyond which it is normal."""


def signed_rank_p_value(values: Array) -> float:
    """One-sided p-value that values tend to be positive (Wilcoxon's signed ranks); 1 for fewer than three values.

    Ranks, as few tosses have residuals far beyond the others', and would decide a mean.

    Args:
        values: (n,), one a toss.
    """
    if len(values) < _FEWEST_RANKS or not np.any(values):
        return 1.0
    if len(values) > _MOST_EXACT:
        return float(wilcoxon(values, alternative="greater", method="asymptotic").pvalue)
    return _exact_p_value(values[values != 0])


def _exact_p_value(values: Array) -> float:
    """The same by the exact distribution of the positive values' ranks, ties included: each sign is as likely.

    scipy has it without ties only. With ties it counts every choice of signs, which takes a second for 12 values.
    """
    twice = np.rint(2 * rankdata(np.abs(values))).astype(int)  # midranks of ties are halves
    chance = np.zeros(twice.sum() + 1)
    chance[0] = 1.0
    for rank in twice:
        chance[rank:] = 0.5 * chance[rank:] + 0.5 * chance[:-rank]
        chance[:rank] *= 0.5
    return float(chance[twice[values > 0].sum() :].sum())


def part_p_value(values: Array) -> float:
    """One-sided p-value that values tend to be positive in any part (Bonferroni).

    Impacts are rough: what acts in sliding would be lost in their noise.

    Args:
        values: (G, n) of G parts and n tosses.
    """
    return min(1.0, len(values) * min(signed_rank_p_value(each) for each in values))


def fewest_tosses(level: float, *, tests: int, effects: int) -> int:
    """The fewest tosses with which an effect can be significant at all: the least n with k L 2^-n < level.

    Args:
        level: Family-wise level, over the effects.
        tests: k, tests of an effect (Bonferroni).
        effects: L, effects of the library (Bonferroni).
    """
    n = max(_FEWEST_RANKS, math.floor(math.log2(max(tests, 1) * max(effects, 1) / level)) + 1)
    while not max(tests, 1) * 2.0**-n < level / max(effects, 1):
        n += 1
    return n


@dataclass(frozen=True)
class TossesNeeded:
    """How many tosses there are, and how many a name needs at least.

    Attributes:
        tosses: How many there are.
        flights: In how many of them free flight is long enough to be judged alone.
        contact: How many an effect needs that acts in contact.
        flight: How many flights an effect needs that flight alone reveals.
    """

    tosses: int
    flights: int
    contact: int
    flight: int

    @staticmethod
    def of(library: Sequence[Effect], level: float, *, tosses: int, flights: int) -> TossesNeeded:
        """What a library needs.

        Args:
            library: The effects that are sought.
            level: Family-wise significance level.
            tosses: How many there are.
            flights: In how many of them free flight can be judged alone.
        """
        flying = sum(Phase.FLIGHT in effect.phases for effect in library)
        contact = fewest_tosses(level, tests=PARTS, effects=len(library))
        return TossesNeeded(tosses, flights, contact, fewest_tosses(level, tests=1, effects=flying))

    @property
    def enough(self) -> bool:
        """Whether every effect of the library could be named."""
        return self.tosses >= self.contact

    def as_json(self) -> dict[str, Any]:
        """gap.json's "tosses_needed"."""
        return {
            "n_tosses": self.tosses,
            "n_flights": self.flights,
            "for_a_name": self.contact,
            "for_a_name_from_flight_alone": self.flight,
            "enough": self.enough,
        }
