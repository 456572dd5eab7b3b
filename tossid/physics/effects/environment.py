"""Effects of the environment: gravity and the ground."""

from __future__ import annotations

from dataclasses import replace

import mujoco
import numpy as np

from tossid.physics.effects.effect import CONTACT_PHASES, Effect, InMujoco, MjcfEdit, Parameter
from tossid.physics.effects.mjcf_edit import Edit, named, write_acceleration
from tossid.physics.effects.strength import Strength, directed, signed
from tossid.physics.effects.world import World
from tossid.rotations import quat_exp, quat_rotate

GROUP_OF_TILTS = frozenset({"uniform_force", "world_tilt", "ground_tilt"})
"""Each is what the other two make: gravity of another direction, in a frame and on a ground that are tilted or not."""


def _write_ground(edit: Edit, before: World, after: World) -> None:
    planes = [g for g in edit.grounds if g.type == mujoco.mjtGeom.mjGEOM_PLANE]
    if len(planes) != 1:
        edit.cannot[edit.effect] = f"the model has {len(planes)} ground planes; move its ground by hand"
        return
    turn = quat_exp(np.array([*after.ground_tilt, 0.0]))
    where = named("geom", planes[0])
    edit.set(planes[0], "quat", turn, where)
    edit.set(planes[0], "pos", after.ground_height * quat_rotate(turn, np.array([0.0, 0.0, 1.0])), where)


GRAVITY = Effect(
    name="gravity",
    family="environment",
    says="gravity differs from the simulator's",
    parameters=(Parameter("g_ms2", None, 0.0, 25.0, 0.05),),
    apply=lambda world, p: replace(world, gravity=p["g_ms2"]),
    read=lambda world: {"g_ms2": world.gravity},
    mujoco=InMujoco(),
    mjcf=MjcfEdit(write_acceleration),
    strength=Strength(0.05, 4.0, signed("g_ms2", 9.81)),
    made_of=frozenset({"time_base"}),  # rigid contact has no time of its own
)

GROUND_TILT = Effect(
    name="ground_tilt",
    family="environment",
    says="the ground is not level",
    parameters=tuple(Parameter(f"{a}_rad", 0.0, -0.2, 0.2, 2e-3) for a in "xy"),
    phases=CONTACT_PHASES,
    apply=lambda world, p: replace(world, ground_tilt=(p["x_rad"], p["y_rad"])),
    mujoco=InMujoco(),
    mjcf=MjcfEdit(_write_ground),
    starts=({"x_rad": 6e-3}, {"x_rad": -6e-3}, {"y_rad": 6e-3}, {"y_rad": -6e-3}),
    strength=Strength(2e-3, 0.1, directed("x_rad", "y_rad")),
    one_of_group=GROUP_OF_TILTS,
)

GROUND_HEIGHT = Effect(
    name="ground_height",
    family="environment",
    says="the ground is not at z = 0",
    parameters=(Parameter("z_m", 0.0, -0.05, 0.05, 5e-4),),
    phases=CONTACT_PHASES,
    apply=lambda world, p: replace(world, ground_height=p["z_m"]),
    mujoco=InMujoco(),
    mjcf=MjcfEdit(_write_ground),
    strength=Strength(5e-4, 0.03, signed("z_m")),
    starts=tuple({"z_m": z} for z in (-25e-3, -8e-3, -2e-3, 2e-3, 8e-3, 25e-3)),
)

EFFECTS = (GRAVITY, GROUND_TILT, GROUND_HEIGHT)
"""The family, in the order in which its effects are fitted and drawn."""
