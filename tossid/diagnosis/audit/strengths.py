"""How strong an effect of an audit's case may be, and worlds with effects."""

from __future__ import annotations

from collections.abc import Mapping

from tossid.objects import ObjectModel
from tossid.physics.effects import Strength, World, effect_named, effects_for
from tossid.physics.effects.strength import directed, scaled, signed

SPOILT: dict[str, Strength] = {
    "gravity": Strength(0.3, 1.5, signed("g_ms2")),
    "com_offset": Strength(2e-3, 8e-3, directed("x_m", "y_m", "z_m")),
    "inertia": Strength(0.25, 0.5, scaled("scale_rel")),
    "friction": Strength(0.2, 0.6, scaled("mu")),
    "geometry": Strength(0.05, 0.1, scaled("size_rel")),
}
"""By how much a parameter of the simulator itself is spoilt: gravity by a sum, friction by a factor. Forty real tosses
of the cube determine inertia to 5 % and size to 2 % (docs/experiments/audit.md)."""


def strengths_for(model: ObjectModel) -> dict[str, Strength]:
    """The strengths of the effects that an object can have, by name.

    Args:
        model: The object; those of joints are only for objects with joints.

    Returns:
        The strengths.
    """
    return {effect.name: effect.strength for effect in effects_for(model) if isinstance(effect.strength, Strength)}


def world_with(world: World, effects: Mapping[str, Mapping[str, float]]) -> World:
    """A world with effects.

    Args:
        world: The world before.
        effects: Values by effect; parameters that are not given have their nominal values.

    Returns:
        The world after all effects, in their order.
    """
    for name, given in effects.items():
        effect = effect_named(name)
        world = effect.at(world, effect.values_with(world, given))
    return world
