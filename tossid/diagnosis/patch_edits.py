"""How each effect is said in MJCF: edits of a MuJoCo model, one function an effect.

Contact by spring and damper, of a bounce and of a compliance, is as `physics.effects.in_mujoco` has it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from tossid.diagnosis.edit import Edit
from tossid.physics.effects import World
from tossid.physics.effects.in_mujoco import (
    BOUNCE_RATE,
    SOFT_IMPEDANCE,
    damping_ratio,
    soft_contact,
)
from tossid.physics.mujoco_engine import RIGID_DAMPING, RIGID_SOLIMP, RIGID_STEP
from tossid.rotations import quat_exp, quat_rotate, quat_to_matrix, skew

Array = NDArray[np.float64]

ANEW = "several links or corners change, each by itself; write the object anew with 'tossid export'"
STEPS_A_SWING = 20.0
"""MuJoCo steps within 1 / omega of a contact's spring."""


def _named(what: str, element: Any) -> str:
    return f"{what} '{element.name}'" if element.name else what


# ---------------------------------------------------------------- body


def _own_inertial(edit: Edit) -> tuple[float, Array, Array]:
    """Mass, centre of mass and inertia (3, 3) of the body, made explicit, so that changed geoms do not change them."""
    m = edit.compiled()
    b = _body_of(m)
    R = quat_to_matrix(m.body_iquat[b])
    inertia = R @ np.diag(m.body_inertia[b]) @ R.T
    mass, com = float(m.body_mass[b]), np.array(m.body_ipos[b])
    _write_inertial(edit.body, mass, com, inertia)
    return mass, com, inertia


def _body_of(m: mujoco.MjModel) -> int:
    """The object's body in a compiled model."""
    return next(i for i in range(1, m.nbody) if m.body_parentid[i] == 0)


def _write_inertial(body: mujoco.MjsBody, mass: float, com: Array, I: Array) -> None:
    body.explicitinertial = True
    body.mass, body.ipos, body.iquat, body.inertia = mass, com, [1, 0, 0, 0], [0, 0, 0]
    body.fullinertia = [I[0, 0], I[1, 1], I[2, 2], I[0, 1], I[0, 2], I[1, 2]]


def _com(edit: Edit, before: World, after: World) -> None:
    mass, com, inertia = _own_inertial(edit)
    to = com + after.object.com[0] - before.object.com[0]
    _write_inertial(edit.body, mass, to, inertia)
    edit.changed(_named("body", edit.body) + " inertial", "pos", com, to)


def _inertia(edit: Edit, before: World, after: World) -> None:
    mass, com, inertia = _own_inertial(edit)
    to = inertia + after.object.inertia[0] - before.object.inertia[0]
    _write_inertial(edit.body, mass, com, to)
    index = ([0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2])
    where = _named("body", edit.body) + " inertial"
    edit.changed(where, "fullinertia", inertia[index], to[index])


def _geometry(edit: Edit, before: World, after: World) -> None:
    was, now = before.object.corner_pos, after.object.corner_pos
    scale = float((was * now).sum() / (was * was).sum())
    if np.abs(now - scale * was).max() > 1e-9:
        edit.cannot[edit.effect] = ANEW
        return
    _own_inertial(edit)
    meshes = set()
    for geom in edit.own:
        where = _named("geom", geom)
        if geom.type == mujoco.mjtGeom.mjGEOM_MESH:
            meshes.add(geom.meshname)
        else:
            edit.set(geom, "size", scale * np.array(geom.size), where)
        edit.set(geom, "pos", scale * np.array(geom.pos), where)
    for mesh in edit.spec.meshes:
        if mesh.name in meshes:
            edit.set(mesh, "scale", scale * np.array(mesh.scale), _named("mesh", mesh))


# ---------------------------------------------------------------- what pulls


def _joints(edit: Edit, before: World, after: World) -> None:
    """A spring's rest is in the file's own unit of angles."""
    law = after.object.joints
    for k, joint in enumerate(edit.joints):
        where = _named("joint", joint)
        hinge = joint.type == mujoco.mjtJoint.mjJNT_HINGE
        unit = np.rad2deg(1.0) if hinge and edit.spec.compiler.degree else 1.0
        # a polynomial in the spec, of which MuJoCo's own law is the first term
        edit.set(joint, "damping", _first_term(joint.damping, law.damping[1 + k]), where)
        edit.set(joint, "frictionloss", law.friction[1 + k], where)
        edit.set(joint, "stiffness", _first_term(joint.stiffness, law.stiffness[1 + k]), where)
        edit.set(joint, "springref", unit * law.rest[1 + k], where)


def _first_term(old: Array, value: float) -> Array:
    return np.array([value, *np.asarray(old)[1:]])


def _gravity(edit: Edit, before: World, after: World) -> None:
    """Gravity and a uniform force: both are accelerations of the centre of mass."""
    m = float(after.object.mass.sum())
    delta = np.array([getattr(after.forces, a) - getattr(before.forces, a) for a in "xyz"]) / m
    delta[2] -= after.gravity - before.gravity
    note = "a uniform force, as gravity" if edit.effect == "uniform_force" else ""
    edit.set(edit.spec.option, "gravity", np.array(edit.spec.option.gravity) + delta, "option", note=note)


def _box(world: World) -> Array:
    """Edges (3,) [m] of the box of MuJoCo's fluid: that of the same mass and inertia."""
    I = np.linalg.eigvalsh(world.object.inertia[0])
    m = float(world.object.mass[0])
    edges: Array = np.sqrt(np.maximum(I.sum() - 2 * I, 1e-15) * 6 / m)
    return edges


def _linear_drag(edit: Edit, before: World, after: World) -> None:
    d = float(_box(after).mean())
    edit.set(
        edit.spec.option,
        "viscosity",
        after.forces.linear / (3 * np.pi * d),
        "option",
        exact=False,
        note=f"MuJoCo's viscosity also resists spin, here by {after.forces.linear * d * d / 3:.2g} N m s",
    )
    if (after.forces.wind_x, after.forces.wind_y) != (0.0, 0.0):
        edit.set(edit.spec.option, "wind", [after.forces.wind_x, after.forces.wind_y, 0.0], "option")


def _quadratic_drag(edit: Edit, before: World, after: World) -> None:
    a, b, c = _box(after)
    area = (a * b + b * c + c * a) / 3
    edit.set(
        edit.spec.option,
        "density",
        after.forces.quadratic / (0.75 * 0.5 * area),
        "option",
        exact=False,
        note="MuJoCo's drag is of a box: as strong on average over directions; it also resists spin",
    )


def _spring(edit: Edit, before: World, after: World) -> None:
    f = after.forces
    center = [f.center_x, f.center_y, f.center_z]
    edit.body.add_site(name="pulled", pos=after.object.com[0])
    edit.spec.worldbody.add_site(name="puller", pos=center)
    tendon = edit.spec.add_tendon(name="pull", stiffness=f.spring, springlength=[0.0, 0.0])
    tendon.wrap_site("pulled")
    tendon.wrap_site("puller")
    where = "tendon 'pull' from the body's site 'pulled' to the world's site 'puller'"
    edit.changed(where, "stiffness", 0, f.spring)
    edit.changed("site 'puller'", "pos", "", center)


# ---------------------------------------------------------------- ground and contact


def _ground(edit: Edit, before: World, after: World) -> None:
    planes = [g for g in edit.grounds if g.type == mujoco.mjtGeom.mjGEOM_PLANE]
    if len(planes) != 1:
        edit.cannot[edit.effect] = f"the model has {len(planes)} ground planes; move its ground by hand"
        return
    turn = quat_exp(np.array([*after.ground_tilt, 0.0]))
    where = _named("geom", planes[0])
    edit.set(planes[0], "quat", turn, where)
    edit.set(planes[0], "pos", after.ground_height * quat_rotate(turn, np.array([0.0, 0.0, 1.0])), where)


def _friction(edit: Edit, before: World, after: World) -> None:
    """Sliding, torsional and rolling friction: MuJoCo takes the larger of two geoms', so both get it."""
    law = after.law
    condim = 6 if law.rolling > 0 else 4 if law.torsional > 0 else 3
    for geom in (*edit.grounds, *edit.own):
        where, now = _named("geom", geom), np.array(geom.friction)
        values = [after.object.friction, law.torsional if condim > 3 else now[1], law.rolling if condim > 4 else now[2]]
        edit.set(geom, "friction", values, where)
        if geom.condim < condim:
            edit.set(geom, "condim", condim, where)
    for pair in edit.spec.pairs:
        now, mu = np.array(pair.friction), after.object.friction
        turning = [law.torsional if condim > 3 else now[2], *([law.rolling if condim > 4 else now[3]] * 2)]
        edit.set(pair, "friction", [mu * law.y_rel, mu, *turning], _named("contact pair", pair))
        edit.set(pair, "condim", max(int(pair.condim), condim), _named("contact pair", pair))


def _pair(edit: Edit, world: World) -> mujoco.MjsPair | None:
    """The explicit contact pair of object and ground, made where there is none yet; None where it would be several."""
    if len(edit.grounds) != 1 or len(edit.own) != 1:
        edit.cannot[edit.effect] = "needs one ground geom and one geom of the object"
        return None
    if edit.spec.pairs:
        return edit.spec.pairs[0]
    (ground,), (own,) = edit.grounds, edit.own
    ground.name, own.name = ground.name or "ground", own.name or "object"
    mu, law = world.object.friction, world.law
    pair = edit.spec.add_pair(
        name="contact",
        geomname1=ground.name,
        geomname2=own.name,
        friction=[mu, mu, max(law.torsional, own.friction[1]), *[max(law.rolling, own.friction[2])] * 2],
        solref=own.solref,
        solimp=own.solimp,
    )
    pair.condim = max(3, own.condim)
    where = f"contact pair '{ground.name}', '{own.name}'"
    edit.changed(where, "condim", "", int(pair.condim), note="a pair of its own")
    return pair


def _anisotropic(edit: Edit, before: World, after: World) -> None:
    """Friction along the plane's two axes: for a level plane, world y and x."""
    pair = _pair(edit, before)
    if pair is not None:
        x, y = after.object.friction, after.object.friction * after.law.y_rel
        edit.set(pair, "friction", [y, x, *np.array(pair.friction)[2:]], "contact pair", note="along y, then along x")


def _corner_mass(world: World) -> float:
    """Mass [kg] behind a corner that lands alone, over all orientations: 1 / mean of J_n M^-1 J_n^T."""
    o = world.object
    arm = o.corner_pos[o.corner_body == 0] - o.com[0]
    inverse = np.linalg.inv(o.inertia[0])
    turned = [np.trace(skew(r).T @ inverse @ skew(r)) / 3 for r in arm]
    return float(1 / (1 / o.mass[0] + np.mean(turned)))


def compliance(edit: Edit, before: World, after: World) -> None:
    """A spring and a damper at each corner, as `effects.in_mujoco` has them: an impedance and its solref."""
    pair = _pair(edit, before)
    if pair is None:
        return
    m = edit.compiled()
    stiffness = 1 / after.object.compliance
    soft = soft_contact(after, float(m.body_invweight0[_body_of(m), 0]))
    where, note = "contact pair", "stiffness and damping of a corner"
    if soft.impedance == SOFT_IMPEDANCE:
        note += ", but for an added mass of 0.2 %"
    edit.set(pair, "solref", soft.solref, where, note=note)
    edit.set(pair, "solimp", soft.solimp, where)
    _finer(edit, 1 / (STEPS_A_SWING * float(np.sqrt(stiffness / (_corner_mass(after) + after.law.added_mass)))))
    if after.law.added_mass == 0:
        edit.set(pair, "solreffriction", soft.solreffriction(edit.spec.option.timestep), where)
    _round_cone(edit)
    edit.set(edit.spec.option, "impratio", soft.impratio, "option", note="friction does not creep")


def _restitution(edit: Edit, before: World, after: World) -> None:
    """A spring and a damper whose pull is cut off, as `effects.in_mujoco` has them."""
    ratio = damping_ratio(max(after.object.restitution, 1e-3))
    _finer(edit, 2 * RIGID_STEP)
    rate = min(BOUNCE_RATE, 0.5 / ratio) / edit.spec.option.timestep
    note = "exact for a corner that lands alone; several at once leave with another speed"
    for where, element in _contacts(edit):
        edit.set(element, "solref", [-(rate**2), -2 * ratio * rate], where, exact=False, note=note)
        edit.set(element, "solimp", RIGID_SOLIMP, where, exact=False)


def _finer(edit: Edit, step: float) -> None:
    """A time step of at most `step` [s]."""
    if step < edit.spec.option.timestep:
        edit.set(edit.spec.option, "timestep", step, "option", note="resolves the contact's spring")


def rigid_contact(edit: Edit) -> None:
    """Contact as rigid as `mujoco_engine` has it, with Coulomb's cone."""
    _finer(edit, 2 * RIGID_STEP)
    solref = [2 * edit.spec.option.timestep, RIGID_DAMPING]
    for where, element in _contacts(edit):
        edit.set(element, "solref", solref, where, note="as stiff as the time step bears")
        edit.set(element, "solimp", RIGID_SOLIMP, where)
    _round_cone(edit)


def _contacts(edit: Edit) -> list[tuple[str, mujoco.MjsGeom | mujoco.MjsPair]]:
    """What contact's numbers stand in, and where that is."""
    geoms = [(_named("geom", geom), geom) for geom in (*edit.grounds, *edit.own)]
    return [*geoms, *((_named("contact pair", pair), pair) for pair in edit.spec.pairs)]


def _round_cone(edit: Edit) -> None:
    """Friction that is the same in all directions."""
    if edit.spec.option.cone != mujoco.mjtCone.mjCONE_ELLIPTIC:
        edit.spec.option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
        edit.changed("option", "cone", "pyramidal", "elliptic")


EDITS: Mapping[str, Callable[[Edit, World, World], None]] = {
    "com_offset": _com,
    "inertia": _inertia,
    "geometry": _geometry,
    "gravity": _gravity,
    "uniform_force": _gravity,
    "linear_drag": _linear_drag,
    "wind": _linear_drag,
    "quadratic_drag": _quadratic_drag,
    "position_force": _spring,
    "ground_tilt": _ground,
    "ground_height": _ground,
    "friction": _friction,
    "torsional_friction": _friction,
    "rolling_resistance": _friction,
    "anisotropic_friction": _anisotropic,
    "compliance": compliance,
    "restitution": _restitution,
    "joint_damping": _joints,
    "joint_friction": _joints,
    "joint_stiffness": _joints,
}

REASONS = {
    "velocity_friction": "MuJoCo's friction does not depend on speed",
    "cohesion": "MuJoCo's friction is in proportion to the load",
    "adhesion": "MuJoCo's adhesion holds against a pull, and takes most of its friction from what slides",
    "rounded_corners": "it takes other geoms: spheres of this radius in the corners of smaller boxes",
    "spin_drag": "MuJoCo's fluid resists spin only together with velocity",
    "magnus": "MuJoCo has it for ellipsoids only",
    "vortex": "MJCF has no force of this form",
    "turning_frame": "MJCF has no force of this form",
}

OF_LINKS = {
    "inertia": ANEW,
    "geometry": ANEW,
    "compliance": "each link needs a contact pair of its own",
    **dict.fromkeys(
        ("linear_drag", "wind", "quadratic_drag", "position_force"), "it is shared among links as MJCF has no word for"
    ),
}
"""What MJCF does not say of an object with joints."""

RECORDED: Mapping[str, Callable[[World], str]] = {
    "length_scale": lambda w: f"divide recorded lengths by {w.recording.length_scale:.6g}",
    "time_base": lambda w: f"divide recorded times by {w.recording.clock_rate:.6g}",
    "body_frame_offset": lambda w: (
        "shift the recorded frame on the body by minus ("
        + ", ".join(f"{x:.6g}" for x in w.recording.frame_offset)
        + ") m, in the body's axes"
    ),
    "joint_offset": lambda w: f"subtract {w.recording.joint_offset:.6g} rad from recorded joint angles",
    "world_tilt": lambda w: (
        "turn the recorded world by minus (" + ", ".join(f"{x:.6g}" for x in w.recording.world_tilt) + ", 0) rad"
    ),
}
