"""Hypotheses: a simulator's world under a law of contact, with effects at values."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from tossid.diagnosis.likelihood.engine_discrepancy import IMPULSE_PARTS, Engine
from tossid.physics.effects import Effect, World
from tossid.physics.mujoco_engine import LIFTING

Array = NDArray[np.float64]


@dataclass(frozen=True)
class ContactLaw:
    """A law of rigid contact that tosses may follow. It is no effect, and no hypothesis is without one.

    Attributes:
        name: "coulomb" (friction of an impact is against the slip after it), "routh" (against the slip as it turns
            meanwhile), "relaxed" (Anitescu's convex relaxation of the first), or "own": that of the simulator that is
            diagnosed.
        lifting: `Law.lifting` of the relaxation [m]; 0 without.
        impulse_parts: `Law.impulse_parts` in which the slip may turn.
        engine: The other engine of the same law, whose differences to ours are no evidence.
    """

    name: str = "coulomb"
    lifting: float = 0.0
    impulse_parts: float = 1.0
    engine: Engine = field(default_factory=Engine)

    def of(self, world: World) -> World:
        """A world under this law.

        Args:
            world: Under any law.
        """
        law = world.law._replace(lifting=self.lifting, impulse_parts=self.impulse_parts)
        return world if law == world.law else replace(world, law=law)


COULOMB = ContactLaw()
ROUTH = ContactLaw("routh", impulse_parts=IMPULSE_PARTS)
RELAXED = ContactLaw("relaxed", lifting=LIFTING)
"""What slides is lifted by so much a metre, which is near the noise of a tracker."""


@dataclass(frozen=True)
class Hypothesis:
    """A world with effects in it.

    Attributes:
        base: The simulator's world.
        law: Of contact.
        effects: In the order in which they are added.
        values: Parameters (P,) of each.
    """

    base: World
    law: ContactLaw = ContactLaw()
    effects: tuple[Effect, ...] = ()
    values: tuple[Array, ...] = ()

    def world(self) -> World:
        """The world with all effects at their values, the same object whenever it is asked for."""
        return self._world

    @cached_property
    def _world(self) -> World:
        world = self.law.of(self.base)
        for effect, values in self.items():
            world = effect.at(world, values)
        return world

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the effects."""
        return tuple(effect.name for effect in self.effects)

    def items(self) -> Iterator[tuple[Effect, Array]]:
        """Its effects, each with its values."""
        return zip(self.effects, self.values, strict=True)

    @property
    def contents(self) -> tuple[str, frozenset[str]]:
        """The law of contact and the effects, whatever their values and order."""
        return self.law.name, frozenset(self.names)

    def effect(self, name: str) -> Effect:
        """One of its effects.

        Args:
            name: Of the effect.
        """
        return self.effects[self.names.index(name)]

    def values_of(self, name: str) -> Array:
        """(P,) parameters of one effect.

        Args:
            name: Of the effect.
        """
        return self.values[self.names.index(name)]

    def nominal_of(self, name: str) -> Array:
        """(P,) parameters of one effect at which it changes nothing beside the others.

        Args:
            name: Of the effect.
        """
        return self.effect(name).nominal(self.without(name).world())

    def place_of(self, name: str) -> slice:
        """Where the parameters of one effect are in `flat`.

        Args:
            name: Of the effect.
        """
        owners = self.owners
        return slice(owners.index(name), owners.index(name) + owners.count(name))

    @property
    def owners(self) -> list[str]:
        """(P,) the name of the effect to which each parameter belongs."""
        return [effect.name for effect in self.effects for _ in effect.parameters]

    def plus(self, effect: Effect, values: Array | None = None) -> Hypothesis:
        """With one more effect.

        Args:
            effect: The effect.
            values: (P,) its parameters; those that change nothing if None.
        """
        values = effect.nominal(self.world()) if values is None else values
        return replace(self, effects=(*self.effects, effect), values=(*self.values, values))

    def with_all(self, effects: Iterable[tuple[Effect, Array]]) -> Hypothesis:
        """With those of some effects that it has not yet.

        Args:
            effects: Each with its parameters (P,).
        """
        made = self
        for effect, values in effects:
            made = made if effect.name in made.names else made.plus(effect, values)
        return made

    def without(self, *names: str) -> Hypothesis:
        """Without some effects.

        Args:
            names: Of the effects.
        """
        kept = [(effect, values) for effect, values in self.items() if effect.name not in names]
        return replace(self, effects=tuple(e for e, _ in kept), values=tuple(v for _, v in kept))

    def with_replaced(self, name: str, effect: Effect, values: Array) -> Hypothesis:
        """With another effect in the place of one, and of the other power with which its force may have grown.

        Args:
            name: Of the effect that is replaced.
            effect: The other one.
            values: (P,) its parameters.
        """
        law = self.effect(name).other_power_law
        kept = self if law is None else self.without(law.name)
        k, effects, all_values = kept.names.index(name), list(kept.effects), list(kept.values)
        effects[k], all_values[k] = effect, values
        return replace(self, effects=tuple(effects), values=tuple(all_values))

    @property
    def steps(self) -> Array:
        """(P,) the declared step of each parameter, by which it is scaled in fits."""
        return np.array([p.step for effect in self.effects for p in effect.parameters])

    @property
    def bounds(self) -> tuple[Array, Array]:
        """(P,) lowest and highest plausible values."""
        parameters = [p for effect in self.effects for p in effect.parameters]
        return np.array([p.low for p in parameters]), np.array([p.high for p in parameters])

    def flat(self) -> Array:
        """(P,) all parameters."""
        return np.concatenate(self.values) if self.values else np.zeros(0)

    def at(self, flat: Array) -> Hypothesis:
        """The same effects with other parameters, limited to their plausible ranges.

        Args:
            flat: (P,) all parameters.
        """
        ends = np.cumsum([len(effect.parameters) for effect in self.effects])[:-1]
        parts = np.split(np.clip(flat, *self.bounds), ends) if self.effects else []
        return replace(self, values=tuple(parts))
