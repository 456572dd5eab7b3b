"""What several effects share: changes of a world (for `Effect.apply`), and bounds."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from tossid.objects import ObjectModel
from tossid.physics.effects.world import World

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
