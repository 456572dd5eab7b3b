"""A MuJoCo model under change, the list of what has changed in it, and parts of edits that several effects share."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from tossid.errors import ObjectError
from tossid.physics.effects.world import World
from tossid.rotations import quat_to_matrix

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Change:
    """One changed attribute of the MJCF.

    Attributes:
        effect: The effect that it expresses.
        where: The element.
        attribute: The attribute.
        before: Its value before.
        after: Its value after.
        exact: Whether MuJoCo's law is the effect's own.
        note: What a reader should know beside.
    """

    effect: str
    where: str
    attribute: str
    before: str
    after: str
    exact: bool = True
    note: str = ""

    def as_json(self) -> dict[str, Any]:
        """The change as plain values, as gap.json has it."""
        return asdict(self)


@dataclass
class Edit:
    """A MuJoCo model under change.

    Attributes:
        spec: The model.
        effect: The effect that is being written.
        changes: What has changed.
        recording: Corrections of the recorded data, by effect.
        cannot: Why MJCF cannot express an effect, by effect.
    """

    spec: mujoco.MjSpec
    effect: str = ""
    changes: list[Change] = field(default_factory=list)
    recording: dict[str, str] = field(default_factory=dict)
    cannot: dict[str, str] = field(default_factory=dict)

    def compiled(self) -> mujoco.MjModel:
        """MuJoCo's model, compiled.

        Raises:
            ObjectError: MuJoCo cannot compile it.
        """
        try:
            return self.spec.compile()
        except (ValueError, mujoco.FatalError) as error:
            raise ObjectError(f"MuJoCo cannot compile the patched model: {str(error).splitlines()[0]}") from error

    @property
    def body(self) -> mujoco.MjsBody:
        """The object's base."""
        return self.spec.worldbody.bodies[0]

    @property
    def own(self) -> list[mujoco.MjsGeom]:
        """Geoms of the object that can collide."""
        return [g for body in self.spec.bodies[1:] for g in body.geoms if g.contype or g.conaffinity]

    @property
    def grounds(self) -> list[mujoco.MjsGeom]:
        """Geoms of the world that the object can collide with."""
        return [g for g in self.spec.worldbody.geoms if g.contype or g.conaffinity]

    @property
    def contacts(self) -> list[tuple[str, mujoco.MjsGeom | mujoco.MjsPair]]:
        """The elements in which contact's numbers stand, each with its name in words."""
        geoms = [(named("geom", geom), geom) for geom in (*self.grounds, *self.own)]
        return [*geoms, *((named("contact pair", pair), pair) for pair in self.spec.pairs)]

    @property
    def joints(self) -> list[mujoco.MjsJoint]:
        """Joints between links, in the order of the links."""
        return [joint for joint in self.spec.joints if joint.type != mujoco.mjtJoint.mjJNT_FREE]

    def set(self, element: Any, attribute: str, value: Any, where: str, *, exact: bool = True, note: str = "") -> None:
        """Set an attribute of an element of the model, and record the change; other arguments are `Change`'s."""
        before = _text(getattr(element, attribute))
        setattr(element, attribute, value)
        after = _text(getattr(element, attribute))
        if before != after:
            self.changed(where, attribute, before, after, exact=exact, note=note)

    def changed(
        self, where: str, attribute: str, before: Any, after: Any, *, exact: bool = True, note: str = ""
    ) -> None:
        """Record a change; the arguments are `Change`'s."""
        self.changes.append(Change(self.effect, where, attribute, _text(before), _text(after), exact, note))


def _text(value: Any) -> str:
    if isinstance(value, str):
        return value
    numbers = np.atleast_1d(np.asarray(value, dtype=float)).round(12) + 0.0
    return " ".join(f"{x:.6g}" for x in numbers)


def named(kind: str, element: Any) -> str:
    """An element in words, with its name if it has one."""
    return f"{kind} '{element.name}'" if element.name else kind


def body_of(m: mujoco.MjModel) -> int:
    """Index of the object's base in a compiled model."""
    return next(i for i in range(1, m.nbody) if m.body_parentid[i] == 0)


def own_inertial(edit: Edit) -> tuple[float, Array, Array]:
    """Mass [kg], centre of mass (3,) [m] and inertia (3, 3) [kg m²] of the base.

    They are made explicit in the model, so that changed geoms do not change them.
    """
    m = edit.compiled()
    b = body_of(m)
    R = quat_to_matrix(m.body_iquat[b])
    inertia = R @ np.diag(m.body_inertia[b]) @ R.T
    mass, com = float(m.body_mass[b]), np.array(m.body_ipos[b])
    write_inertial(edit.body, mass, com, inertia)
    return mass, com, inertia


def write_inertial(body: mujoco.MjsBody, mass: float, com: Array, I: Array) -> None:
    """Set a body's mass [kg], centre of mass (3,) [m] and inertia (3, 3) about it [kg m²]."""
    body.explicitinertial = True
    body.mass, body.ipos, body.iquat, body.inertia = mass, com, [1, 0, 0, 0], [0, 0, 0]
    body.fullinertia = [I[0, 0], I[1, 1], I[2, 2], I[0, 1], I[0, 2], I[1, 2]]


def write_acceleration(edit: Edit, before: World, after: World) -> None:
    """Set gravity to that of a world with a uniform force: both are accelerations of the centre of mass."""
    m = float(after.object.mass.sum())
    delta = np.array([getattr(after.forces, a) - getattr(before.forces, a) for a in "xyz"]) / m
    delta[2] -= after.gravity - before.gravity
    note = "a uniform force, as gravity" if before.gravity == after.gravity else ""
    edit.set(edit.spec.option, "gravity", np.array(edit.spec.option.gravity) + delta, "option", note=note)


def refine_step(edit: Edit, step: float) -> None:
    """Set a time step that is at most so long [s]."""
    if step < edit.spec.option.timestep:
        edit.set(edit.spec.option, "timestep", step, "option", note="resolves the contact's spring")


def round_cone(edit: Edit) -> None:
    """Set friction that is the same in all directions."""
    if edit.spec.option.cone != mujoco.mjtCone.mjCONE_ELLIPTIC:
        edit.spec.option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
        edit.changed("option", "cone", "pyramidal", "elliptic")
