"""How strong an effect of an audit's case may be, and worlds with effects."""

from __future__ import annotations

from collections.abc import Mapping

from tossid.objects import ObjectModel
from tossid.physics.effects import Strength, World, effect_named, effects_for


def strengths_for(model: ObjectModel) -> dict[str, Strength]:
    """The strengths of the effects that an object can have, by name.

    Args:
        model: The object; those of joints are only for objects with joints.
    """
    return {effect.name: effect.strength for effect in effects_for(model) if isinstance(effect.strength, Strength)}


def world_with(world: World, effects: Mapping[str, Mapping[str, float]]) -> World:
    """A world with effects.

    Args:
        world: The world before.
        effects: Values by effect, applied in their order; parameters that are not given have their nominal values.
    """
    for name, given in effects.items():
        effect = effect_named(name)
        world = effect.at(world, effect.values_with(world, given))
    return world
