"""The effects that there are: those of the families, and those that a user registers."""

from __future__ import annotations

from tossid.code_digest import note_registered
from tossid.errors import InputError
from tossid.objects import ObjectModel
from tossid.physics.effects import body, contact, environment, field, fluid, joint, measurement
from tossid.physics.effects.effect import Effect

_FAMILIES = (body, environment, fluid, field, contact, measurement, joint)

BUILT_IN: tuple[Effect, ...] = tuple(effect for family in _FAMILIES for effect in family.EFFECTS)
"""The effects of the families, in the order in which they are fitted and drawn."""
LIBRARY = tuple(effect for effect in BUILT_IN if not effect.needs_joints)
"""Those that every object can have."""
JOINT_EFFECTS = tuple(effect for effect in BUILT_IN if effect.needs_joints)
"""Those of objects with joints."""

_registered: dict[str, Effect] = {}


def register_effect(effect: Effect) -> Effect:
    """Add an effect to the library of this process: diagnoses fit it, and synthesis and audits can contain it.

    Raises:
        InputError: There is an effect of this name.
    """
    if effect.name in {other.name for other in all_effects()}:
        raise InputError(f"there already is an effect '{effect.name}'")
    note_registered(effect)
    _registered[effect.name] = effect
    return effect


def unregister_effect(name: str) -> None:
    """Take out an effect that was registered.

    Raises:
        InputError: No effect of this name was registered.
    """
    if _registered.pop(name, None) is None:
        raise InputError(f"no effect '{name}' was registered")


def all_effects() -> tuple[Effect, ...]:
    """All effects, those of the families first."""
    return (*BUILT_IN, *_registered.values())


def effects_for(model: ObjectModel) -> tuple[Effect, ...]:
    """The effects that an object can have, in the form and with the bounds that they have for it.

    Effects of joints are only for objects with joints, those of sharp corners for objects whose shape has no round
    part.
    """
    possible = [effect for effect in all_effects() if model.roundness is None or not effect.sharp_only]
    if not model.n_joints:
        return tuple(effect.bounded(model) for effect in possible if not effect.needs_joints)
    return tuple((effect.of_links or effect).bounded(model) for effect in possible)


def effect_named(name: str) -> Effect:
    """The effect of a name, or of the name of an effect's `other_power_law`, in its form for objects without joints.

    Raises:
        InputError: There is none.
    """
    for effect in all_effects():
        for found in (effect, effect.other_power_law):
            if found is not None and found.name == name:
                return found
    raise InputError(f"there is no effect '{name}' in the library")
