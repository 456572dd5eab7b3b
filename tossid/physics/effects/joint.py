"""Effects of joints. Of several joints, each is the same in all of them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace

import mujoco
import numpy as np
from numpy.typing import NDArray

from tossid.objects import JointLaw
from tossid.physics.effects.changes import Apply, with_object
from tossid.physics.effects.effect import Effect, InMujoco, MjcfEdit, Parameter, RecordingCorrection
from tossid.physics.effects.mjcf_edit import Edit, named
from tossid.physics.effects.strength import Strength, plain, signed
from tossid.physics.effects.world import World

Array = NDArray[np.float64]


def _sets_joints(**names: str) -> Apply:
    """An `apply` whose parameters are numbers of the joints' law."""

    def apply(world: World, p: Mapping[str, float]) -> World:
        there = np.arange(world.object.n_bodies) > 0
        law = {**world.object.joints._asdict(), **{field: p[name] * there for field, name in names.items()}}
        return with_object(world, joint_law=JointLaw(**law))

    return apply


def _reads_joints(**names: str) -> Callable[[World], Mapping[str, float]]:
    """Their values in a world: the means over its joints."""

    def read(world: World) -> Mapping[str, float]:
        law = world.object.joints
        return {name: float(getattr(law, field)[1:].mean()) for field, name in names.items()}

    return read


def _write_joints(edit: Edit, before: World, after: World) -> None:
    """A spring's rest is in the file's own unit of angles."""
    law = after.object.joints
    for k, joint in enumerate(edit.joints):
        where = named("joint", joint)
        hinge = joint.type == mujoco.mjtJoint.mjJNT_HINGE
        unit = np.rad2deg(1.0) if hinge and edit.spec.compiler.degree else 1.0
        # a polynomial in the spec, of which MuJoCo's own law is the first term
        edit.set(joint, "damping", _first_term(joint.damping, law.damping[1 + k]), where)
        edit.set(joint, "frictionloss", law.friction[1 + k], where)
        edit.set(joint, "stiffness", _first_term(joint.stiffness, law.stiffness[1 + k]), where)
        edit.set(joint, "springref", unit * law.rest[1 + k], where)


def _first_term(old: Array, value: float) -> Array:
    return np.array([value, *np.asarray(old)[1:]])


DAMPING = Effect(
    name="joint_damping",
    family="joint",
    says="a joint resists in proportion to its rate",
    parameters=(Parameter("c_nms", None, 0.0, 0.1, 2e-5),),
    apply=_sets_joints(damping="c_nms"),
    read=_reads_joints(damping="c_nms"),
    mujoco=InMujoco(),
    mjcf=MjcfEdit(_write_joints),
    strength=Strength(5e-5, 0.02, plain("c_nms")),
    starts=({"c_nms": 2e-4}, {"c_nms": 2e-3}),
    needs_joints=True,
)

FRICTION = Effect(
    name="joint_friction",
    family="joint",
    says="a joint rubs: a torque of constant size against its rate",
    parameters=(Parameter("torque_nm", None, 0.0, 0.5, 2e-4),),
    apply=_sets_joints(friction="torque_nm"),
    read=_reads_joints(friction="torque_nm"),
    mujoco=InMujoco(),
    mjcf=MjcfEdit(_write_joints),
    strength=Strength(3e-4, 0.1, plain("torque_nm")),
    starts=({"torque_nm": 1e-3}, {"torque_nm": 1e-2}),
    needs_joints=True,
)

STIFFNESS = Effect(
    name="joint_stiffness",
    family="joint",
    says="a joint has a spring, as a cable's",
    parameters=(Parameter("k_nmprad", None, 0.0, 5.0, 2e-3), Parameter("rest_rad", None, -3.2, 3.2, 0.05, form=True)),
    apply=_sets_joints(stiffness="k_nmprad", rest="rest_rad"),
    read=_reads_joints(stiffness="k_nmprad", rest="rest_rad"),
    mujoco=InMujoco(),
    mjcf=MjcfEdit(_write_joints),
    strength=Strength(1e-3, 0.5, lambda size, u: {"k_nmprad": size, "rest_rad": 1.5 * float(u[0])}),
    starts=({"k_nmprad": 0.01}, {"k_nmprad": 0.1}),
    needs_joints=True,
)

OFFSET = Effect(
    name="joint_offset",
    family="joint",
    says="recorded joint angles are off by a constant",
    parameters=(Parameter("angle_rad", 0.0, -1.0, 1.0, 2e-3),),
    apply=lambda world, p: replace(world, recording=replace(world.recording, joint_offset=p["angle_rad"])),
    mujoco=InMujoco(),
    mjcf=RecordingCorrection(
        lambda world: f"subtract {world.recording.joint_offset:.6g} rad from recorded joint angles"
    ),
    strength=Strength(5e-3, 0.5, signed("angle_rad")),
    starts=tuple({"angle_rad": angle} for angle in (-0.1, -0.03, 0.03, 0.1)),
    needs_joints=True,
)

EFFECTS = (DAMPING, FRICTION, STIFFNESS, OFFSET)
"""The family, in the order in which its effects are fitted and drawn."""
