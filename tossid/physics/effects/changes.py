"""What several effects share: changes of a world (for `Effect.apply`), bounds, and the states that forces depend on."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tossid.objects import ObjectModel
from tossid.physics.effects.world import World
from tossid.physics.forces import LEAST_STATE, Forces, PoweredForce

Array = NDArray[np.float64]
Apply = Callable[[World, Mapping[str, float]], World]


def with_object(world: World, **changes: Any) -> World:
    """The world with fields of its object replaced, as by `ObjectModel.with_changes`."""
    return replace(world, object=world.object.with_changes(**changes))


def sets_forces(**names: str) -> Apply:
    """An `apply` whose parameters are numbers of `Forces`: by field, the parameter's name."""
    return lambda world, p: replace(world, forces=world.forces._replace(**{k: p[n] for k, n in names.items()}))


def sets_law(**names: str) -> Apply:
    """An `apply` whose parameters are numbers of the contact's `Law`: by field, the parameter's name."""
    return lambda world, p: replace(world, law=world.law._replace(**{k: p[n] for k, n in names.items()}))


def half_size(model: ObjectModel) -> float:
    """Half of the largest distance between an object's corners [m]: no patch of contact has a larger radius."""
    corners = model.drawn.corner_pos
    return 0.5 * float(np.linalg.norm(corners[:, None] - corners[None], axis=-1).max())


def half_thickness(model: ObjectModel) -> float:
    """Half of an object's smallest extent along its axes [m]: no corner is rounder."""
    return 0.5 * float(np.ptp(model.drawn.corner_pos, axis=0).min())


def air_speed(forces: Forces, u: Array) -> Array:
    """Velocity (*b, 3) [m/s] relative to the air, of velocities u (*b, 3) in the world."""
    return u - np.array([forces.wind_x, forces.wind_y, 0.0])


def size_of(state: Array) -> Array:
    """Length (*b, 1) of vectors (*b, n)."""
    size: Array = np.linalg.norm(state, axis=-1, keepdims=True)
    return size


def power_factor(forces: Forces, which: PoweredForce, state: Array) -> Array:
    """Factor (*b, 1) of a force that grows with a further power of its state (*b, n); 1 for the others."""
    size = np.maximum(size_of(state), LEAST_STATE)
    return size**forces.power if forces.powered == which else np.ones_like(size)
