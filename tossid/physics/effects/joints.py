"""The effects of objects with joints. Of several joints or links, each is the same in all of them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np

from tossid.objects import JointLaw, ObjectModel
from tossid.physics.effects.effect import Effect, Parameter
from tossid.physics.effects.library import ALL, LIBRARY
from tossid.physics.effects.world import World


def _joints(**names: str) -> Callable[[World, Mapping[str, float]], World]:
    """An effect whose parameters are numbers of the joints' law."""

    def apply(world: World, p: Mapping[str, float]) -> World:
        there = np.arange(world.object.n_bodies) > 0
        law = {**world.object.joints._asdict(), **{field: p[name] * there for field, name in names.items()}}
        return replace(world, object=world.object.with_changes(joint_law=JointLaw(**law)))

    return apply


def _read(**names: str) -> Callable[[World], Mapping[str, float]]:
    """Their values in a world: the means over its joints."""

    def read(world: World) -> Mapping[str, float]:
        law = world.object.joints
        return {name: float(getattr(law, field)[1:].mean()) for field, name in names.items()}

    return read


def _links_inertia(world: World, p: Mapping[str, float]) -> World:
    """All moments of inertia times a factor, and what mass does along the links' own y and z times another.

    The second moments of mass along the axes, S = tr(I) / 2 E - I, are what is scaled: so I = tr(S) E - S stays the
    inertia of some body.
    """
    I, E = world.object.inertia, np.eye(3)
    second = 0.5 * np.trace(I, axis1=1, axis2=2)[:, None, None] * E - I
    along = np.sqrt(p["scale_rel"] * np.array([1.0, p["along_y_rel"], p["along_z_rel"]]))
    second = second * np.outer(along, along)
    return replace(
        world, object=world.object.with_changes(inertia=np.trace(second, axis1=1, axis2=2)[:, None, None] * E - second)
    )


LINKS_INERTIA = Effect(
    "inertia",
    "body",
    (
        Parameter("scale_rel", 1.0, 0.2, 5.0, 0.03),
        Parameter("along_y_rel", 1.0, 0.05, 10.0, 0.05),
        Parameter("along_z_rel", 1.0, 0.05, 10.0, 0.05),
    ),
    ALL,
    "the links' moments of inertia are not those stated",
    _links_inertia,
    starts=(
        *({"scale_rel": scale, "along_y_rel": 1.0, "along_z_rel": 1.0} for scale in (0.45, 0.7, 1.4, 2.0)),
        {"scale_rel": 1.0, "along_y_rel": 0.5, "along_z_rel": 0.5},
        {"scale_rel": 0.5, "along_y_rel": 2.0, "along_z_rel": 1.0},
        {"scale_rel": 0.5, "along_y_rel": 1.0, "along_z_rel": 2.0},
    ),
)
"""In the place of the library's `inertia`: what links do to one another depends on its shape, in flight too."""

JOINT_EFFECTS: tuple[Effect, ...] = (
    Effect(
        "joint_damping",
        "joint",
        (Parameter("c_nms", None, 0.0, 0.1, 2e-5),),
        ALL,
        "a joint resists in proportion to its rate",
        _joints(damping="c_nms"),
        _read(damping="c_nms"),
        starts=({"c_nms": 2e-4}, {"c_nms": 2e-3}),
    ),
    Effect(
        "joint_friction",
        "joint",
        (Parameter("torque_nm", None, 0.0, 0.5, 2e-4),),
        ALL,
        "a joint rubs: a torque of constant size against its rate",
        _joints(friction="torque_nm"),
        _read(friction="torque_nm"),
        starts=({"torque_nm": 1e-3}, {"torque_nm": 1e-2}),
    ),
    Effect(
        "joint_stiffness",
        "joint",
        (Parameter("k_nmprad", None, 0.0, 5.0, 2e-3), Parameter("rest_rad", None, -3.2, 3.2, 0.05)),
        ALL,
        "a joint has a spring, as a cable's",
        _joints(stiffness="k_nmprad", rest="rest_rad"),
        _read(stiffness="k_nmprad", rest="rest_rad"),
        starts=({"k_nmprad": 0.01}, {"k_nmprad": 0.1}),
    ),
    Effect(
        "joint_offset",
        "joint",
        (Parameter("angle_rad", 0.0, -1.0, 1.0, 2e-3),),
        ALL,
        "recorded joint angles are off by a constant",
        lambda w, p: replace(w, recording=replace(w.recording, joint_offset=p["angle_rad"])),
        starts=tuple({"angle_rad": angle} for angle in (-0.1, -0.03, 0.03, 0.1)),
    ),
)


def library_for(model: ObjectModel) -> tuple[Effect, ...]:
    """The effects that an object can have: those of joints only where it has any."""
    if not model.n_joints:
        return LIBRARY
    return (*(LINKS_INERTIA if each.name == LINKS_INERTIA.name else each for each in LIBRARY), *JOINT_EFFECTS)
