"""Effects of the measurement: what is wrong with the recording, and not with the simulator."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from tossid.physics.effects.effect import (
    CONTACT_PHASES,
    Effect,
    InMujoco,
    NotExpressible,
    Parameter,
    RecordingCorrection,
)
from tossid.physics.effects.environment import GROUP_OF_TILTS
from tossid.physics.effects.strength import Strength, directed, scaled
from tossid.physics.effects.world import World


def _recorded(world: World, **changes: Any) -> World:
    return replace(world, recording=replace(world.recording, **changes))


def _listed(values: tuple[float, ...]) -> str:
    return ", ".join(f"{x:.6g}" for x in values)


LENGTH_SCALE = Effect(
    name="length_scale",
    family="measurement",
    says="recorded lengths are too short or too long",
    parameters=(Parameter("scale_rel", 1.0, 0.7, 1.4, 1e-3),),
    apply=lambda world, p: _recorded(world, length_scale=p["scale_rel"]),
    mujoco=InMujoco(),
    mjcf=RecordingCorrection(lambda world: f"divide recorded lengths by {world.recording.length_scale:.6g}"),
    strength=Strength(2e-3, 0.2, scaled("scale_rel")),
)

TIME_BASE = Effect(
    name="time_base",
    family="measurement",
    says="the recording's clock is too fast or too slow",
    parameters=(Parameter("rate_rel", 1.0, 0.7, 1.4, 1e-3),),
    apply=lambda world, p: _recorded(world, clock_rate=p["rate_rel"]),
    mujoco=InMujoco(),
    mjcf=RecordingCorrection(lambda world: f"divide recorded times by {world.recording.clock_rate:.6g}"),
    strength=Strength(2e-3, 0.2, scaled("rate_rel")),
    made_of=frozenset({"gravity"}),  # rigid contact has no time of its own
)

BODY_FRAME_OFFSET = Effect(
    name="body_frame_offset",
    family="measurement",
    says="the recorded frame does not sit where the object's frame is",
    parameters=tuple(Parameter(f"{a}_m", 0.0, -0.05, 0.05, 5e-4) for a in "xyz"),
    apply=lambda world, p: _recorded(world, frame_offset=(p["x_m"], p["y_m"], p["z_m"])),
    mujoco=InMujoco(),
    mjcf=RecordingCorrection(
        lambda world: (
            f"shift the recorded frame on the body by minus ({_listed(world.recording.frame_offset)}) m, "
            "in the body's axes"
        )
    ),
    strength=Strength(7e-4, 0.03, directed("x_m", "y_m", "z_m")),
)

WORLD_TILT = Effect(
    name="world_tilt",
    family="measurement",
    says="the recorded world is tilted against the vertical",
    parameters=tuple(Parameter(f"{a}_rad", 0.0, -0.2, 0.2, 2e-3) for a in "xy"),
    apply=lambda world, p: _recorded(world, world_tilt=(p["x_rad"], p["y_rad"])),
    mujoco=InMujoco(),
    mjcf=RecordingCorrection(
        lambda world: f"turn the recorded world by minus ({_listed(world.recording.world_tilt)}, 0) rad"
    ),
    strength=Strength(2e-3, 0.1, directed("x_rad", "y_rad")),
    one_of_group=GROUP_OF_TILTS,
)

ROTATION_DELAY = Effect(
    name="rotation_delay",
    family="measurement",
    says="recorded rotations are of an earlier or later time than recorded positions",
    parameters=(Parameter("delay_s", 0.0, -0.02, 0.02, 2e-4),),
    phases=CONTACT_PHASES,  # a steady spin does not show it
    apply=lambda world, p: _recorded(world, rotation_delay=p["delay_s"]),
    mujoco=InMujoco(),
    mjcf=RecordingCorrection(lambda world: f"record rotations {world.recording.rotation_delay:.6g} s earlier"),
    strength=NotExpressible("it moves no position, by which an audit measures strengths"),
    starts=({"delay_s": -3e-3}, {"delay_s": 3e-3}),
)

EFFECTS = (LENGTH_SCALE, TIME_BASE, BODY_FRAME_OFFSET, WORLD_TILT, ROTATION_DELAY)
"""The family, in the order in which its effects are fitted and drawn."""
