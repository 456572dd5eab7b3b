"""What repeats of the search found: how often they name each effect, and how far its values scatter.

Each repeat has its own values. Where they scatter more than the interval of the search says, the interval is as wide as
their scatter: what depends on the length of windows or on their first frames is not known better.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from tossid.diagnosis.findings import Interval
from tossid.physics.effects import Effect

_NORMAL = 1.96
"""Standard deviations of a normal distribution either side of its mean that hold 95 % of it."""


@dataclass(frozen=True)
class Repeat:
    """What one repeat of the search found.

    Attributes:
        names: Of the effects that it named, in the order in which they joined.
        closed: Share of the gap that they close on its tosses.
        special: Names of special cases of these effects.
        parameters: Of each of these effects, as it was fitted to its tosses.
        nameless: Names of effects beside them that only stand in for something else.
    """

    names: tuple[str, ...]
    closed: float
    special: frozenset[str] = frozenset()
    parameters: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    nameless: tuple[str, ...] = ()

    def as_json(self) -> dict[str, Any]:
        """An entry of gap.json's "explanation.repeated"."""
        effects = {name: dict(self.parameters.get(name, {})) for name in self.names}
        return {"effects": effects, "nameless": list(self.nameless), "closed": self.closed}


@dataclass(frozen=True)
class Stability:
    """What all repeats found.

    Attributes:
        repeats: Each of them; none if none were asked for.
        least_closed: Share of the gap below which a repeat's names explain nothing.
    """

    repeats: tuple[Repeat, ...] = ()
    least_closed: float = 0.5

    def frequency(self, names: Collection[str]) -> float | None:
        """The share of repeats that name at least one of some effects; None without repeats.

        A repeat that names what contains an effect names that effect too. Resampled tosses favour the more general of
        two effects, as they are alike.

        Args:
            names: Of an effect, or of all of a confusable class.
        """
        if not self.repeats:
            return None
        named = [not set(names).isdisjoint({*each.names, *each.special}) for each in self.repeats]
        return sum(named) / len(named)

    def scatter(self, effect: Effect, beside: Collection[str], fewest: int) -> dict[str, float]:
        """1.96 standard deviations of an effect's values over the repeats, by parameter; none if too few have it.

        Repeats count that have the same others of its group. A ground that is tilted in a tilted world is tilted by the
        difference: that is another quantity.

        Args:
            effect: The effect.
            beside: Names of the effects of the hypothesis whose values are compared.
            fewest: How many repeats must have it.
        """
        group = effect.one_of_group - {effect.name}
        values = [
            each.parameters[effect.name]
            for each in self.repeats
            if effect.name in each.parameters and group & {*each.names, *each.nameless} == group & {*beside}
        ]
        if len(values) < fewest:
            return {}
        return {key: _NORMAL * float(np.std([each[key] for each in values], ddof=1)) for key in values[0]}

    def widened(
        self, effect: Effect, known: Mapping[str, Interval], beside: Collection[str], fewest: int
    ) -> dict[str, Interval]:
        """An effect's 95 % intervals, no narrower than its values scatter over the repeats.

        Args:
            effect: The effect.
            known: Its intervals, by parameter.
            beside: Names of the effects of the hypothesis that these are of.
            fewest: How many repeats must have it.
        """
        out, scatter = dict(known), self.scatter(effect, beside, fewest)
        for parameter in effect.parameters if scatter else ():
            own, half = known[parameter.name], scatter[parameter.name]
            low, high = np.clip([own.value - half, own.value + half], parameter.low, parameter.high)
            out[parameter.name] = Interval(own.value, min(own.low, float(low)), max(own.high, float(high)))
        return out

    @property
    def probability_none(self) -> float | None:
        """The share of repeats in which no effect of the library explains the gap; None without repeats.

        Either nothing is named, or what is named closes less than a share of it.
        """
        if not self.repeats:
            return None
        return sum(not each.names or each.closed < self.least_closed for each in self.repeats) / len(self.repeats)
