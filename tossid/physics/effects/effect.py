"""What an effect is: a change of a `World` with a few parameters.

At its nominal values it changes nothing; two have none such, and begin near: wind, which without drag is no effect, and
compliance, whose nothing is infinite.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from tossid.physics.effects.world import World
from tossid.types import Phase


@dataclass(frozen=True)
class Parameter:
    """A number of an effect, SI.

    nominal: the value that changes nothing, None for "as the world has it" (read by the effect). low, high: the
    plausible range. step: a small change that matters, for differences and for scaling.
    """

    name: str
    nominal: float | None
    low: float
    high: float
    step: float


@dataclass(frozen=True)
class Effect:
    """One cause of a gap.

    Attributes:
        name: CONTRACT.md's.
        family: body, environment, fluid, field, contact, joint or measurement.
        parameters: its numbers.
        phases: where it acts.
        says: what it is, for the report.
        apply: the world with the effect, given the parameters' values by name.
        read: the parameters' values in a world (for those without a fixed nominal).
        contains: effects that are special cases of it.
        starts: values from which it is also looked for, where what it does is far from linear.
    """

    name: str
    family: str
    parameters: tuple[Parameter, ...]
    phases: tuple[Phase, ...]
    says: str
    apply: Callable[[World, Mapping[str, float]], World]
    read: Callable[[World], Mapping[str, float]] = lambda world: {}
    contains: tuple[str, ...] = ()
    starts: tuple[Mapping[str, float], ...] = ()

    def nominal(self, world: World) -> np.ndarray:
        """Values (P,) at which the effect changes nothing in this world."""
        here = self.read(world)
        return np.array([here[p.name] if p.nominal is None else p.nominal for p in self.parameters])

    def named(self, values: np.ndarray) -> dict[str, float]:
        """Values (P,) by the parameters' names."""
        return dict(zip((p.name for p in self.parameters), map(float, values), strict=True))

    def at(self, world: World, values: np.ndarray) -> World:
        """The world with the effect at the values (P,), brought back into their range."""
        named = {p.name: float(np.clip(x, p.low, p.high)) for p, x in zip(self.parameters, values, strict=True)}
        return self.apply(world, named)
