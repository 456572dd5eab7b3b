"""Effects of the body: its centre of mass, its inertia, its size and its corners."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import mujoco
import numpy as np

from tossid.physics.effects.changes import half_size, half_thickness, sets_law, with_object
from tossid.physics.effects.effect import (
    CONTACT_PHASES,
    EVERY_PHASE,
    Effect,
    InMujoco,
    MjcfEdit,
    NotExpressible,
    Parameter,
)
from tossid.physics.effects.mjcf_edit import Edit, named, own_inertial, write_inertial
from tossid.physics.effects.strength import Strength, directed, plain, scaled
from tossid.physics.effects.world import World

_ANEW = NotExpressible("several links or corners change, each by itself; write the object anew with 'tossid export'")
_LINKS_STARTS = (
    *({"scale_rel": scale, "along_y_rel": 1.0, "along_z_rel": 1.0} for scale in (0.45, 0.7, 1.4, 2.0)),
    {"scale_rel": 1.0, "along_y_rel": 0.5, "along_z_rel": 0.5},
    {"scale_rel": 0.5, "along_y_rel": 2.0, "along_z_rel": 1.0},
    {"scale_rel": 0.5, "along_y_rel": 1.0, "along_z_rel": 2.0},
)
"""From where fits of several links' inertia begin."""


def _shifted_com(world: World, p: Mapping[str, float]) -> World:
    com = world.object.com.copy()
    com[0] += [p["x_m"], p["y_m"], p["z_m"]]
    return with_object(world, com=com)


def _links_inertia(world: World, p: Mapping[str, float]) -> World:
    """All moments of inertia times a factor, and what mass does along the links' own y and z times another.

    The second moments of mass along the axes, S = tr(I) / 2 E - I, are what is scaled: so I = tr(S) E - S stays the
    inertia of some body.
    """
    I, E = world.object.inertia, np.eye(3)
    second = 0.5 * np.trace(I, axis1=1, axis2=2)[:, None, None] * E - I
    along = np.sqrt(p["scale_rel"] * np.array([1.0, p["along_y_rel"], p["along_z_rel"]]))
    second = second * np.outer(along, along)
    return with_object(world, inertia=np.trace(second, axis1=1, axis2=2)[:, None, None] * E - second)


def _write_com(edit: Edit, before: World, after: World) -> None:
    mass, com, inertia = own_inertial(edit)
    to = com + after.object.com[0] - before.object.com[0]
    write_inertial(edit.body, mass, to, inertia)
    edit.changed(named("body", edit.body) + " inertial", "pos", com, to)


def _write_inertia(edit: Edit, before: World, after: World) -> None:
    mass, com, inertia = own_inertial(edit)
    to = inertia + after.object.inertia[0] - before.object.inertia[0]
    write_inertial(edit.body, mass, com, to)
    index = ([0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2])
    edit.changed(named("body", edit.body) + " inertial", "fullinertia", inertia[index], to[index])


def _write_size(edit: Edit, before: World, after: World) -> None:
    was, now = (np.stack(world.object.extent()) for world in (before, after))
    if before.object.roundness is None:
        was, now = before.object.corner_pos, after.object.corner_pos
    scale = float((was * now).sum() / (was * was).sum())
    if np.abs(now - scale * was).max() > 1e-9:
        _ANEW.write(edit, before, after)
        return
    own_inertial(edit)
    meshes = set()
    for geom in edit.own:
        where = named("geom", geom)
        if geom.type == mujoco.mjtGeom.mjGEOM_MESH:
            meshes.add(geom.meshname)
        else:
            edit.set(geom, "size", scale * np.array(geom.size), where)
        edit.set(geom, "pos", scale * np.array(geom.pos), where)
    for mesh in edit.spec.meshes:
        if mesh.name in meshes:
            edit.set(mesh, "scale", scale * np.array(mesh.scale), named("mesh", mesh))


COM_OFFSET = Effect(
    name="com_offset",
    family="body",
    says="the centre of mass is not where the object's model has it",
    parameters=tuple(Parameter(f"{a}_m", 0.0, -0.04, 0.04, 1e-3, limit=half_size) for a in "xyz"),
    apply=_shifted_com,
    mujoco=InMujoco(),
    mjcf=MjcfEdit(_write_com),
    strength=Strength(3e-4, 0.02, directed("x_m", "y_m", "z_m")),
)

INERTIA = Effect(
    name="inertia",
    family="body",
    says="the moments of inertia are larger or smaller than stated",
    parameters=(Parameter("scale_rel", 1.0, 0.2, 5.0, 0.03),),
    phases=CONTACT_PHASES,
    apply=lambda world, p: with_object(world, inertia=p["scale_rel"] * world.object.inertia),
    mujoco=InMujoco(),
    mjcf=MjcfEdit(_write_inertia, of_links=_ANEW),
    strength=Strength(0.04, 1.0, scaled("scale_rel")),
    starts=tuple({"scale_rel": scale} for scale in (0.45, 0.7, 0.88, 1.14, 1.5, 2.0)),
)
# what links do to one another depends on the shape of their inertia, in flight too
INERTIA = replace(
    INERTIA,
    of_links=replace(
        INERTIA,
        says="the links' moments of inertia are not those stated",
        parameters=(
            Parameter("scale_rel", 1.0, 0.2, 5.0, 0.03),
            Parameter("along_y_rel", 1.0, 0.05, 10.0, 0.05),
            Parameter("along_z_rel", 1.0, 0.05, 10.0, 0.05),
        ),
        phases=EVERY_PHASE,
        apply=_links_inertia,
        mjcf=_ANEW,
        starts=_LINKS_STARTS,
    ),
)

GEOMETRY = Effect(
    name="geometry",
    family="body",
    says="the object is larger or smaller than stated",
    parameters=(Parameter("size_rel", 1.0, 0.8, 1.25, 2e-3),),
    phases=CONTACT_PHASES,
    apply=lambda world, p: replace(world, object=world.object.resized(p["size_rel"])),
    mujoco=InMujoco(),
    mjcf=MjcfEdit(_write_size, of_links=_ANEW),
    strength=Strength(3e-3, 0.1, scaled("size_rel")),
    starts=tuple({"size_rel": size} for size in (0.93, 0.965, 0.99, 1.01, 1.035, 1.07)),
)

ROUNDED_CORNERS = Effect(
    name="rounded_corners",
    family="body",
    says="corners and edges are rounded",
    parameters=(Parameter("radius_m", 0.0, 0.0, 0.025, 5e-4, limit=half_thickness),),
    phases=CONTACT_PHASES,
    apply=sets_law(rounding="radius_m"),
    mujoco=NotExpressible("the hull of the object has sharp corners", lambda world: world.law.rounding != 0.0),
    mjcf=NotExpressible("it takes other geoms: spheres of this radius in the corners of smaller boxes"),
    strength=Strength(1e-3, 0.02, plain("radius_m")),
    starts=({"radius_m": 0.002}, {"radius_m": 0.008}),
    sharp_only=True,
)

EFFECTS = (COM_OFFSET, INERTIA, GEOMETRY, ROUNDED_CORNERS)
"""The family, in the order in which its effects are fitted and drawn."""
