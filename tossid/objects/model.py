"""An object: a kinematic tree with a free base, its inertia, contact corners and tags."""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import IntEnum
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tossid.errors import ObjectError
from tossid.objects.roundness import Roundness, directions, farthest
from tossid.settings.limits import VALUES

Array = NDArray[np.float64]

GRAVITY = 9.81
"""Standard gravity of every stated simulator here [m/s²] (CONTRACT: nominal)."""
HULL_POINTS = 1000
"""Directions in which points of a round body's surface are taken, where they are listed or made a mesh."""
DRAWN_POINTS = 200
"""The same where it is drawn."""


class JointType(IntEnum):
    """Joint between a body and its parent. Only the base is FREE."""

    FREE = 0
    HINGE = 1
    SLIDE = 2


class JointLaw(NamedTuple):
    """What acts in the joints, by body: each (n_b,), 0 for the base. Of slides newtons and metres take the place.

    Attributes:
        damping: Torque against the rate, over the rate [N m s/rad].
        friction: Coulomb's: the largest torque against the rate [N m].
        stiffness: Torque towards the rest, over the angle from there [N m/rad].
        rest: The angle at which the spring is at rest [rad].
        armature: Inertia of the drive [kg m²].
    """

    damping: Array
    friction: Array
    stiffness: Array
    rest: Array
    armature: Array

    @property
    def acts(self) -> bool:
        """Whether anything acts; a spring's rest alone does not."""
        return any(bool(part.any()) for part in (self.damping, self.friction, self.stiffness, self.armature))


def free_joints(n_bodies: int) -> JointLaw:
    """Joints in which nothing acts."""
    return JointLaw(*np.zeros((5, n_bodies)))


@dataclass(frozen=True, slots=True)
class Tag:
    """An AprilTag (36h11) on a body.

    Attributes:
        id: Its id.
        size: Outer edge of the black border [m].
        body: Index of the body that it is on.
        T_body_tag: (4, 4) its pose; the tag's x points right, y up, z out toward the viewer.
    """

    id: int
    size: float
    body: int
    T_body_tag: Array


@dataclass(frozen=True)
class ObjectModel:
    """A kinematic tree; body 0 is the free base, parents come before children.

    Attributes:
        name: the object's name.
        body_names: (n_b) names.
        parent: (n_b,) index of the parent, -1 for the base.
        joint_type: (n_b,) of `JointType`.
        joint_pos: (n_b, 3) joint anchor in the body's frame [m].
        joint_axis: (n_b, 3) joint axis in the body's frame, unit.
        body_pos, body_quat: (n_b, 3), (n_b, 4) T_parent_body at joint zero.
        mass: (n_b,) [kg].
        com: (n_b, 3) centre of mass in the body's frame [m].
        inertia: (n_b, 3, 3) about the centre of mass, in the body's axes [kg m²].
        corner_body: (n_c,) body of each contact corner.
        corner_pos: (n_c, 3) corner in its body's frame [m].
        friction: Coulomb coefficient of object and ground.
        restitution: Newton's coefficient, 0 for none.
        width: the length that relative position errors refer to [m].
        tags: AprilTags on the bodies.
        mjcf: the model as MJCF text, as loaded.
        compliance: how far a corner sinks for each newton on it [m/N], 0 for rigid contact.
        relaxation: damping over stiffness of a corner [s].
        cohesion: friction of a loaded corner beyond `friction` times its load [N].
        joint_law: what acts in the joints; nothing if None.
        roundness: what stands at each corner in place of a point; points if None.

    Raises:
        ObjectError: A value is not finite, of a sign that cannot be, or beyond `tossid.settings.limits.ValueLimits`.
    """

    name: str
    body_names: tuple[str, ...]
    parent: NDArray[np.int64]
    joint_type: NDArray[np.int64]
    joint_pos: Array
    joint_axis: Array
    body_pos: Array
    body_quat: Array
    mass: Array
    com: Array
    inertia: Array
    corner_body: NDArray[np.int64]
    corner_pos: Array
    friction: float
    restitution: float
    width: float
    tags: tuple[Tag, ...]
    mjcf: str
    compliance: float = 0.0
    relaxation: float = 0.0
    cohesion: float = 0.0
    joint_law: JointLaw | None = None
    roundness: Roundness | None = None

    def __post_init__(self) -> None:
        limits = {
            "friction": ("", VALUES.friction),
            "restitution": ("", 1.0),
            "compliance": (" m/N", VALUES.contact),
            "relaxation": (" s", VALUES.contact),
            "cohesion": (" N", VALUES.contact),
        }
        for name, (unit, limit) in limits.items():
            value = getattr(self, name)
            if not 0 <= value <= limit:
                raise ObjectError(f"object '{self.name}': {name} is {value}{unit}, expected 0 to {limit:g}{unit}")
        if not 0 < self.width <= VALUES.length:
            raise ObjectError(f"object '{self.name}': width is {self.width} m, expected up to {VALUES.length:g} m")
        lengths = dict.fromkeys(("com", "corner_pos", "body_pos", "joint_pos"), ("m", VALUES.length))
        largest = {"mass": ("kg", VALUES.mass), "inertia": ("kg m²", VALUES.mass * VALUES.length**2), **lengths}
        for name, (unit, limit) in largest.items():
            size = np.abs(getattr(self, name)).max(initial=0.0)
            if not size <= limit:  # NaN, too
                raise ObjectError(
                    f"object '{self.name}': {name} reaches {size} {unit}, expected at most {limit:g} {unit}"
                )
        if self.roundness is not None and len(self.roundness.radius) != self.n_corners:
            raise ObjectError(f"object '{self.name}': {len(self.roundness.radius)} round corners of {self.n_corners}")
        if (self.mass <= 0).any():
            raise ObjectError(f"object '{self.name}': mass of a body is {self.mass.min():g} kg, expected more than 0")
        for name, values in self.joints._asdict().items():
            if np.shape(values) != (self.n_bodies,) or not np.isfinite(values).all():
                raise ObjectError(f"object '{self.name}': {name} of its joints must be one finite number a body")
            if name != "rest" and (values < 0).any():
                raise ObjectError(f"object '{self.name}': {name} of a joint is {values.min():g}, expected at least 0")

    @property
    def joints(self) -> JointLaw:
        """What acts in the joints."""
        return free_joints(self.n_bodies) if self.joint_law is None else self.joint_law

    @property
    def n_bodies(self) -> int:
        """Number of bodies, the base included."""
        return len(self.parent)

    @property
    def n_joints(self) -> int:
        """Number of joints; each body but the base has one."""
        return self.n_bodies - 1

    @property
    def nq(self) -> int:
        """Length of a configuration."""
        return 7 + self.n_joints

    @property
    def nv(self) -> int:
        """Length of a velocity."""
        return 6 + self.n_joints

    @property
    def n_corners(self) -> int:
        """Number of contact corners."""
        return len(self.corner_body)

    @property
    def is_stated(self) -> bool:
        """Whether it has a shape; false of a recording with `object=unknown`."""
        return self.n_corners > 0

    @property
    def center(self) -> Array:
        """Middle of the base body's extent along its axes, in its frame [m]; its origin without corners. (3,)."""
        if not (self.corner_body == 0).any():
            return np.zeros(3)
        low, high = self.extent()
        return 0.5 * (low + high)

    def extent(self, body: int = 0) -> tuple[Array, Array]:
        """How far a body with corners reaches along the axes of its frame: lowest and highest coordinates (3,) [m]."""
        low, high = (self.support(sign * np.eye(3), body).max(axis=1) for sign in (-1.0, 1.0))
        return -low, high

    def support(self, ways: Array, body: int = 0) -> Array:
        """How far each corner of a body reaches in some directions: (k, n) [m].

        Args:
            ways: (k, 3) directions in the body's axes, unit.
            body: With corners.
        """
        out: Array = np.einsum("ki,kci->kc", ways, self._farthest(ways, body))
        return out

    def _farthest(self, ways: Array, body: int) -> Array:
        own = self.corner_body == body
        return farthest(self.corner_pos[own], None if self.roundness is None else self.roundness.of(own), ways)

    def hull_points(self, body: int = 0) -> Array:
        """Points whose hull a body is: its corners, or of a round one many points of its surface. (n, 3) [m]."""
        points = self.as_points()
        own = points.corner_pos[points.corner_body == body]
        return own if self.roundness is None else np.unique(own.round(9), axis=0)

    @cached_property
    def drawn(self) -> ObjectModel:
        """The same with points of its surface as corners where it is round: what figures show."""
        return self.as_points(DRAWN_POINTS)

    def as_points(self, count: int = HULL_POINTS) -> ObjectModel:
        """The same with points of its surface as corners where it is round.

        Args:
            count: Directions (`roundness.directions`), in whose order the farthest points of each body stand.
        """
        if self.roundness is None:
            return self
        ways, bodies = directions(count), np.unique(self.corner_body)
        points = []
        for body in bodies:
            each = self._farthest(ways, body)
            points.append(each[np.arange(count), np.einsum("ki,kci->kc", ways, each).argmax(axis=1)])
        return self.with_changes(
            corner_body=np.repeat(bodies, count), corner_pos=np.concatenate(points), roundness=None
        )

    def resized(self, size: float) -> ObjectModel:
        """A copy whose shape is larger or smaller by a factor, about the bodies' origins."""
        roundness = None if self.roundness is None else self.roundness.scaled(size)
        return self.with_changes(corner_pos=size * self.corner_pos, roundness=roundness)

    def with_changes(self, **changes: Any) -> ObjectModel:
        """A copy with fields replaced (`mjcf` is then out of date: write it with `to_mjcf`)."""
        return replace(self, **changes)
