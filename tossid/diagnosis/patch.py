"""The patch: what a diagnosis found, as changed MJCF and as changed keys of the object.

MuJoCo has a word for most effects, and an exact one for some. Where its word is another law than ours (its contact
is as stiff as the mass behind it, its drag is of a box) the change says so, and the rerun (`patch_rerun`) shows what
it is worth. What MJCF cannot say is listed with the reason.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from tossid.diagnosis.fitting import Hypothesis
from tossid.errors import ObjectError
from tossid.objects import to_mjcf
from tossid.physics.effects import World
from tossid.physics.mujoco_engine import RIGID_DAMPING, RIGID_SOLIMP, RIGID_STEP
from tossid.rotations import quat_exp, quat_rotate, quat_to_matrix

Array = NDArray[np.float64]

STEPS_A_SWING = 20.0
"""MuJoCo steps within 1 / omega of a contact's spring."""
FIRM_SOLIMP = (0.99, 0.99, 0.001, 0.5, 2.0)
"""Impedance at which a contact's stiffness and damping are what `solref` says."""


@dataclass(frozen=True)
class Change:
    """One attribute of the MJCF. exact: MuJoCo's law is the effect's own."""

    effect: str
    where: str
    attribute: str
    before: str
    after: str
    exact: bool = True
    note: str = ""

    def as_json(self) -> dict[str, Any]:
        """As in gap.json."""
        return dict(vars(self))


@dataclass(frozen=True)
class Patch:
    """Changes of a simulator.

    mjcf: the changed model's text. before, after: both models as MuJoCo compiled them.
    keys: changed numbers of tossid's own object and simulator, {key: {"before", "after"}}. recording: corrections of
    the recorded data in place of the simulator, {effect: text}. not_expressed: {effect: why MJCF has no word for it}.
    """

    mjcf: str
    before: mujoco.MjModel
    after: mujoco.MjModel
    changes: tuple[Change, ...]
    keys: dict[str, dict[str, Any]]
    recording: dict[str, str]
    not_expressed: dict[str, str]

    def as_json(self) -> dict[str, Any]:
        """gap.json's "patch" but for the rerun."""
        return {
            "keys": self.keys,
            "changes": [change.as_json() for change in self.changes],
            "recording": self.recording,
            "not_expressed": self.not_expressed,
            "mjcf": self.mjcf if self.changes else None,
        }


def make_patch(hypothesis: Hypothesis, *, mjcf: Path | None = None) -> Patch:
    """What turns the hypothesis's base world into the world with its effects.

    Args:
        mjcf: the file of the user's own MuJoCo model; a near rigid scene of the base world if None.

    Raises:
        ObjectError: MuJoCo cannot compile the model.
    """
    spec = read_spec(mjcf or _rigid_scene(hypothesis.base))
    edit = _Edit(spec)
    before = hypothesis.base
    if mjcf is None and before.object.compliance > 0:  # what the base already has and rigid MJCF lacks
        _compliance(edit, before, before)
        edit.changes.clear()
    compiled = edit.compiled()
    if before.residual is not None:
        edit.cannot["residual"] = "a learned residual acceleration has no counterpart in MJCF"
    world = before
    for effect, values in zip(hypothesis.effects, hypothesis.values, strict=True):
        after = effect.at(world, values)
        edit.effect = effect.name
        if effect.name in _RECORDED:
            edit.recording[effect.name] = _RECORDED[effect.name](after)
        elif effect.name in _EDITS:
            _EDITS[effect.name](edit, world, after)
        else:
            edit.cannot[effect.name] = _REASONS.get(effect.name, "MJCF has no word for it")
        world = after
    patched = edit.compiled()
    if mjcf is not None:  # the text is for another place than the file's
        spec.meshdir = str(mjcf.resolve().parent / spec.meshdir)
    keys = _keys(before, world)
    return Patch(spec.to_xml(), compiled, patched, tuple(edit.changes), keys, edit.recording, edit.cannot)


def _rigid_scene(world: World) -> str:
    """The world in MuJoCo, with contact as rigid as `mujoco_engine` states it, at twice its time step."""
    step = 2 * RIGID_STEP
    solref = (2 * step, RIGID_DAMPING)
    return to_mjcf(world.object, gravity=world.gravity, timestep=step, solref=solref, solimp=RIGID_SOLIMP)


@dataclass
class _Edit:
    """A MuJoCo model under change."""

    spec: mujoco.MjSpec
    effect: str = ""
    changes: list[Change] = field(default_factory=list)
    recording: dict[str, str] = field(default_factory=dict)
    cannot: dict[str, str] = field(default_factory=dict)

    def compiled(self) -> mujoco.MjModel:
        try:
            return self.spec.compile()
        except (ValueError, mujoco.FatalError) as error:
            raise ObjectError(f"MuJoCo cannot compile the patched model: {str(error).splitlines()[0]}") from error

    @property
    def body(self) -> mujoco.MjsBody:
        return self.spec.worldbody.bodies[0]

    @property
    def own(self) -> list[mujoco.MjsGeom]:
        """Geoms of the object that touch."""
        return [g for g in self.body.geoms if g.contype or g.conaffinity]

    @property
    def grounds(self) -> list[mujoco.MjsGeom]:
        """What the object lands on."""
        return [g for g in self.spec.worldbody.geoms if g.contype or g.conaffinity]

    def set(self, element: Any, attribute: str, value: Any, where: str, *, exact: bool = True, note: str = "") -> None:
        """Set an attribute, and note it."""
        before = _text(getattr(element, attribute))
        setattr(element, attribute, value)
        after = _text(getattr(element, attribute))
        if before != after:
            self.changes.append(Change(self.effect, where, attribute, before, after, exact, note))


def read_spec(source: str | Path) -> mujoco.MjSpec:
    """A MuJoCo model, from a file or from text.

    Raises:
        ObjectError: MuJoCo cannot read it.
    """
    try:
        if isinstance(source, Path):
            return mujoco.MjSpec.from_file(str(source))
        return mujoco.MjSpec.from_string(source)
    except (ValueError, mujoco.FatalError) as error:
        raise ObjectError(f"MuJoCo cannot read the model: {str(error).splitlines()[0]}") from error


def _named(what: str, element: Any) -> str:
    return f"{what} '{element.name}'" if element.name else what


def _text(value: Any) -> str:
    numbers = np.atleast_1d(np.asarray(value, dtype=float)).round(12) + 0.0
    return " ".join(f"{x:.6g}" for x in numbers)


# ---------------------------------------------------------------- body


def _own_inertial(edit: _Edit) -> tuple[float, Array, Array]:
    """Mass, centre of mass and inertia (3, 3) of the body, made explicit, so that changed geoms do not change them."""
    m = edit.compiled()
    b = next(i for i in range(1, m.nbody) if m.body_parentid[i] == 0)
    R = quat_to_matrix(m.body_iquat[b])
    inertia = R @ np.diag(m.body_inertia[b]) @ R.T
    mass, com = float(m.body_mass[b]), np.array(m.body_ipos[b])
    _write_inertial(edit.body, mass, com, inertia)
    return mass, com, inertia


def _write_inertial(body: mujoco.MjsBody, mass: float, com: Array, I: Array) -> None:
    body.explicitinertial = True
    body.mass, body.ipos, body.iquat, body.inertia = mass, com, [1, 0, 0, 0], [0, 0, 0]
    body.fullinertia = [I[0, 0], I[1, 1], I[2, 2], I[0, 1], I[0, 2], I[1, 2]]


def _com(edit: _Edit, before: World, after: World) -> None:
    mass, com, inertia = _own_inertial(edit)
    to = com + after.object.com[0] - before.object.com[0]
    _write_inertial(edit.body, mass, to, inertia)
    edit.changes.append(Change(edit.effect, _named("body", edit.body) + " inertial", "pos", _text(com), _text(to)))


def _inertia(edit: _Edit, before: World, after: World) -> None:
    mass, com, inertia = _own_inertial(edit)
    to = inertia + after.object.inertia[0] - before.object.inertia[0]
    _write_inertial(edit.body, mass, com, to)
    index = ([0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2])
    where = _named("body", edit.body) + " inertial"
    edit.changes.append(Change(edit.effect, where, "fullinertia", _text(inertia[index]), _text(to[index])))


def _geometry(edit: _Edit, before: World, after: World) -> None:
    was, now = before.object.corner_pos, after.object.corner_pos
    scale = float((was * now).sum() / (was * was).sum())
    if np.abs(now - scale * was).max() > 1e-9:
        edit.cannot[edit.effect] = "the corners move one by one; write the object anew with 'tossid export'"
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


def _gravity(edit: _Edit, before: World, after: World) -> None:
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


def _linear_drag(edit: _Edit, before: World, after: World) -> None:
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


def _quadratic_drag(edit: _Edit, before: World, after: World) -> None:
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


def _spring(edit: _Edit, before: World, after: World) -> None:
    f = after.forces
    center = [f.center_x, f.center_y, f.center_z]
    edit.body.add_site(name="pulled", pos=after.object.com[0])
    edit.spec.worldbody.add_site(name="puller", pos=center)
    tendon = edit.spec.add_tendon(name="pull", stiffness=f.spring, springlength=[0.0, 0.0])
    tendon.wrap_site("pulled")
    tendon.wrap_site("puller")
    where = "tendon 'pull' from the body's site 'pulled' to the world's site 'puller'"
    edit.changes.append(Change(edit.effect, where, "stiffness", "0", _text(f.spring)))
    edit.changes.append(Change(edit.effect, "site 'puller'", "pos", "", _text(center)))


# ---------------------------------------------------------------- ground and contact


def _ground(edit: _Edit, before: World, after: World) -> None:
    planes = [g for g in edit.grounds if g.type == mujoco.mjtGeom.mjGEOM_PLANE]
    if len(planes) != 1:
        edit.cannot[edit.effect] = f"the model has {len(planes)} ground planes; move its ground by hand"
        return
    turn = quat_exp(np.array([*after.ground_tilt, 0.0]))
    where = _named("geom", planes[0])
    edit.set(planes[0], "quat", turn, where)
    edit.set(planes[0], "pos", after.ground_height * quat_rotate(turn, np.array([0.0, 0.0, 1.0])), where)


def _friction(edit: _Edit, before: World, after: World) -> None:
    """Sliding, torsional and rolling friction: MuJoCo takes the larger of two geoms', so both get it."""
    law = after.law
    condim = 6 if law.rolling > 0 else 4 if law.torsional > 0 else 3
    for geom in (*edit.grounds, *edit.own):
        where, now = _named("geom", geom), np.array(geom.friction)
        values = [after.object.friction, law.torsional if condim > 3 else now[1], law.rolling if condim > 4 else now[2]]
        edit.set(geom, "friction", values, where)
        if geom.condim < condim:
            edit.set(geom, "condim", condim, where)


def _anisotropic(edit: _Edit, before: World, after: World) -> None:
    """A contact pair with a friction of its own along the plane's two axes: for a level plane, world y and x."""
    x = after.object.friction
    y = x * after.law.y_rel
    if len(edit.grounds) != 1 or len(edit.own) != 1:
        edit.cannot[edit.effect] = "needs one ground geom and one geom of the object"
        return
    (ground,), (own,) = edit.grounds, edit.own
    ground.name, own.name = ground.name or "ground", own.name or "object"
    friction = [y, x, own.friction[1], own.friction[2], own.friction[2]]
    pair = edit.spec.add_pair(
        geomname1=ground.name, geomname2=own.name, friction=friction, solref=own.solref, solimp=own.solimp
    )
    pair.condim = max(3, own.condim)
    was = _text([before.object.friction] * 2)
    where = f"contact pair '{ground.name}', '{own.name}'"
    edit.changes.append(Change(edit.effect, where, "friction", was, _text(friction), note="along y, then along x"))


def _corner_mass(world: World) -> float:
    """Mass [kg] behind a corner that lands alone, over all orientations: 1 / mean of J_n M^-1 J_n^T."""
    o = world.object
    arm = o.corner_pos[o.corner_body == 0] - o.com[0]
    inverse = np.linalg.inv(o.inertia[0])
    turned = [np.trace(_cross(r).T @ inverse @ _cross(r)) / 3 for r in arm]
    return float(1 / (1 / o.mass[0] + np.mean(turned)))


def _cross(r: Array) -> Array:
    return np.array([[0, -r[2], r[1]], [r[2], 0, -r[0]], [-r[1], r[0], 0]])


def _compliance(edit: _Edit, before: World, after: World) -> None:
    o = after.object
    m = _corner_mass(after)
    k = 1 / o.compliance
    solref = [-k / m, -k * o.relaxation / m]
    note = f"MuJoCo's contact is as stiff as the mass behind it: that of a corner that lands alone, {m:.3g} kg"
    for geom in (*edit.grounds, *edit.own):
        where = _named("geom", geom)
        edit.set(geom, "solref", solref, where, exact=False, note=note)
        edit.set(geom, "solimp", FIRM_SOLIMP, where, exact=False)
    _finer(edit, np.sqrt(k / m))


def _restitution(edit: _Edit, before: World, after: World) -> None:
    """A damping ratio at which a corner that lands alone leaves with e of its speed: ln e = -pi z / sqrt(1 - z²)."""
    e = min(max(after.object.restitution, 1e-3), 0.999)
    ratio = float(-np.log(e) / np.hypot(np.pi, np.log(e)))
    note = "MuJoCo bounces by a spring: a corner alone rebounds with e, several at once differ"
    fastest = 0.0
    for geom in (*edit.grounds, *edit.own):
        old = np.array(geom.solref)
        omega = float(1 / (old[0] * old[1])) if old[0] > 0 else float(np.sqrt(-old[0]))
        omega = min(omega, 500.0)
        where = _named("geom", geom)
        edit.set(geom, "solref", [1 / (ratio * omega), ratio], where, exact=False, note=note)
        edit.set(geom, "solimp", FIRM_SOLIMP, where, exact=False)
        fastest = max(fastest, omega)
    _finer(edit, fastest)


def _finer(edit: _Edit, omega: float) -> None:
    """A time step that resolves a contact's spring [rad/s]."""
    step = 1 / (STEPS_A_SWING * omega)
    if step < edit.spec.option.timestep:
        edit.set(edit.spec.option, "timestep", step, "option", note="resolves the contact's spring")


def _adhesion(edit: _Edit, before: World, after: World) -> None:
    for geom in edit.own:
        edit.set(geom, "adhesion", after.law.adhesion, _named("geom", geom), note="needs MuJoCo 4")


_EDITS: Mapping[str, Callable[[_Edit, World, World], None]] = {
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
    "compliance": _compliance,
    "restitution": _restitution,
    "adhesion": _adhesion,
}

_REASONS = {
    "velocity_friction": "MuJoCo's friction does not depend on speed",
    "cohesion": "MuJoCo's friction is in proportion to the load",
    "spin_drag": "MuJoCo's fluid resists spin only together with velocity",
    "magnus": "MuJoCo has it for ellipsoids only",
    "vortex": "MJCF has no force of this form",
    "turning_frame": "MJCF has no force of this form",
}

_RECORDED: Mapping[str, Callable[[World], str]] = {
    "length_scale": lambda w: f"divide recorded lengths by {w.recording.length_scale:.6g}",
    "time_base": lambda w: f"divide recorded times by {w.recording.clock_rate:.6g}",
    "body_frame_offset": lambda w: (
        "shift the recorded frame on the body by minus ("
        + ", ".join(f"{x:.6g}" for x in w.recording.frame_offset)
        + ") m, in the body's axes"
    ),
    "world_tilt": lambda w: (
        "turn the recorded world by minus (" + ", ".join(f"{x:.6g}" for x in w.recording.world_tilt) + ", 0) rad"
    ),
}


def _keys(before: World, after: World) -> dict[str, dict[str, Any]]:
    """Numbers of the object and of the simulator that differ."""
    pairs: dict[str, tuple[Any, Any]] = {}
    for name in ("friction", "restitution", "compliance", "relaxation", "cohesion", "mass", "com", "inertia"):
        pairs[f"object.{name}"] = (getattr(before.object, name), getattr(after.object, name))
    pairs["object.corner_pos"] = (before.object.corner_pos, after.object.corner_pos)
    pairs["gravity"] = (before.gravity, after.gravity)
    pairs["ground_height"] = (before.ground_height, after.ground_height)
    pairs["ground_tilt"] = (before.ground_tilt, after.ground_tilt)
    for part in ("forces", "law"):
        one, other = getattr(before, part), getattr(after, part)
        pairs |= {f"{part}.{name}": (getattr(one, name), getattr(other, name)) for name in one._fields}
    for name in vars(before.recording):
        pairs[f"recording.{name}"] = (getattr(before.recording, name), getattr(after.recording, name))
    return {
        name: {"before": np.asarray(was).tolist(), "after": np.asarray(now).tolist()}
        for name, (was, now) in pairs.items()
        if not np.array_equal(was, now)
    }
