"""An effect of a user's own, registered from outside: a pull along x that grows with height."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import NamedTuple

from tossid.physics import register_force
from tossid.physics.effects import (
    Effect,
    InMujoco,
    NotExpressible,
    Parameter,
    Strength,
    register_effect,
    unregister_effect,
)
from tossid.physics.effects.effect import EVERY_PHASE
from tossid.physics.effects.strength import signed


class HeightPull(NamedTuple):
    k_npm: float


@register_force(HeightPull)
def height_pull(force, position, velocity, spin):  # type: ignore[no-untyped-def]
    return (force.k_npm * position[2], 0.0, 0.0), (0.0, 0.0, 0.0)


HEIGHT_PULL = Effect(
    name="height_pull",
    family="field",
    says="a pull along x that grows with height",
    parameters=(Parameter("k_npm", 0.0, -20.0, 20.0, 0.05),),
    phases=EVERY_PHASE,
    apply=lambda world, p: world.with_force(HeightPull(p["k_npm"])),
    mujoco=InMujoco(),
    mjcf=NotExpressible("MJCF has no force that depends on height"),
    strength=Strength(0.1, 5.0, signed("k_npm")),
)


@contextmanager
def registered() -> Iterator[Effect]:
    """The library with the toy effect."""
    try:
        yield register_effect(HEIGHT_PULL)
    finally:
        unregister_effect(HEIGHT_PULL.name)
