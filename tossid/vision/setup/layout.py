"""What is in a scene: rigid bodies, static or moving, the tags on them, and what was measured between tags."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tossid.errors import ObjectError
from tossid.objects import JointType, ObjectModel, Tag
from tossid.rotations import quat_to_matrix
from tossid.vision.setup.hinge import Hinge

Array = NDArray[np.float64]


FAMILIES = {"tag36h11": 8, "tag25h9": 7, "tag16h5": 6}
"""The AprilTag families that can be used, and how many cells across each is, its black border included."""
SQUARE = np.array([[-1.0, -1.0, 0.0], [1.0, -1.0, 0.0], [1.0, 1.0, 0.0], [-1.0, 1.0, 0.0]])
"""Corners of a tag of half size 1: bottom-left, bottom-right, top-right, top-left, (4, 3)."""
DEFAULT_FAMILY = "tag36h11"
"""The family of a tag where none is named."""


@dataclass(frozen=True, eq=False)
class BodyTag:
    """A tag on a body.

    Attributes:
        id: Its number in its family.
        size: Outer edge of the black border [m].
        T_body_tag: (4, 4) its pose on the body, None if unknown.
        position_noise: (3,) standard deviations of its position [m], None for an exact one.
        rotation_noise: (3,) standard deviations of its orientation [rad], None for an exact one.
        family: One of `FAMILIES`.
    """

    id: int
    size: float
    T_body_tag: Array | None
    position_noise: Array | None = None
    rotation_noise: Array | None = None
    family: str = DEFAULT_FAMILY


@dataclass(frozen=True, eq=False)
class Body:
    """A rigid body.

    Attributes:
        name: As in `tagslam.yaml`.
        is_static: Whether it never moves.
        T_map_body: (4, 4) pose of a static body, None if unknown or moving.
        default_tag_size: Size of tags found on it that are not listed [m].
        tags: The tags on it.
        position_noise: (3,) standard deviations of its position [m], None for an exact one.
        rotation_noise: (3,) standard deviations of its orientation [rad], None for an exact one.
        ignored_tags: Ids that are not taken for its own.
        hinge: Hinge on which a moving body hangs, None for a free one.
    """

    name: str
    is_static: bool
    T_map_body: Array | None = None
    default_tag_size: float | None = None
    tags: tuple[BodyTag, ...] = ()
    position_noise: Array | None = None
    rotation_noise: Array | None = None
    ignored_tags: frozenset[int] = frozenset()
    hinge: Hinge | None = None


@dataclass(frozen=True, eq=False)
class Measurement:
    """A measured length: the distance between two points of tags on static bodies, or one point's coordinate.

    Attributes:
        name: As in `tagslam.yaml`.
        points: One or two points, each a tag's id and its corner (0 to 3), None for its centre.
        length: What was measured [m].
        noise: Its standard deviation [m].
        direction: (3,) unit, map frame, along which a single point's coordinate is measured; None for a distance.
    """

    name: str
    points: tuple[tuple[int, int | None], ...]
    length: float
    noise: float
    direction: Array | None = None


@dataclass(frozen=True, slots=True)
class Remap:
    """Tag `id` is called `new_id` when seen from `start` to `end` [s] (by `camera`; None: by any)."""

    id: int
    new_id: int
    start: float
    end: float
    camera: str | None = None


@dataclass(frozen=True, slots=True)
class Squash:
    """Tags that are not to be used, at one time [s] (None: always) and of one camera (None: of any)."""

    tags: frozenset[int]
    time: float | None = None
    camera: str | None = None


@dataclass(frozen=True, eq=False)
class TagLayout:
    """All bodies of a scene.

    An id means one tag, of one family.

    Attributes:
        bodies: The bodies, with their tags.
        default_body: The body that tags not listed belong to, None for none.
        parameters: TagSLAM's `tagslam_parameters` as they are.
        measurements: Distances and coordinates of tags.
        remaps: Tags that are called otherwise for some time.
        squashes: Tags that are not used.
        max_hamming: Most corrected bits of a tag that is used, None for any.
        tag_family: Family of tags that are not listed.
    """

    bodies: tuple[Body, ...]
    default_body: str | None = None
    parameters: dict[str, Any] = field(default_factory=dict)
    measurements: tuple[Measurement, ...] = ()
    remaps: tuple[Remap, ...] = ()
    squashes: tuple[Squash, ...] = ()
    max_hamming: int | None = None
    tag_family: str = DEFAULT_FAMILY

    @cached_property
    def families(self) -> dict[int, str]:
        """The family of each listed tag, by id."""
        return {tag.id: tag.family for body in self.bodies for tag in body.tags}

    def body(self, name: str) -> Body | None:
        """The body of that name, None if there is none."""
        return next((body for body in self.bodies if body.name == name), None)


def layout_of(model: ObjectModel) -> TagLayout:
    """The scene of an object and a fixed rig of cameras at the world's origin."""
    moving = [Body(name, False, tags=body_tags(model, b)) for b, name in enumerate(model.body_names)]
    return TagLayout(
        (Body("rig", True, np.eye(4)), *moving), parameters={"pixel_noise": 1.0, "minimum_viewing_angle": 12.0}
    )


def body_tags(model: ObjectModel, body: int) -> tuple[BodyTag, ...]:
    """The tags on one body of an object, at exactly known poses."""
    return tuple(BodyTag(tag.id, tag.size, tag.T_body_tag) for tag in model.tags if tag.body == body)


def object_body(layout: TagLayout, body_names: Sequence[str]) -> Body | None:
    """The body of a scene that is an object's first one, None if there is none.

    It is found by its name. For an object of one body, the scene's only moving body with tags is taken, whatever its
    name.

    Args:
        layout: The scene.
        body_names: Of the object.

    Returns:
        The body.
    """
    named = layout.body(body_names[0])
    moving = [body for body in layout.bodies if not body.is_static and body.tags]
    return moving[0] if named is None and len(body_names) == 1 and len(moving) == 1 else named


def object_tags(layout: TagLayout, body_names: Sequence[str]) -> tuple[Tag, ...]:
    """The tags of known pose on the named bodies of an object (`object_body`).

    Raises:
        ObjectError: no such body, or no tag of known pose on any.
    """
    bodies = [object_body(layout, body_names), *(layout.body(name) for name in body_names[1:])]
    tags = [
        Tag(tag.id, tag.size, b, tag.T_body_tag)
        for b, body in enumerate(bodies)
        if body is not None
        for tag in body.tags
        if tag.T_body_tag is not None
    ]
    if not tags:
        names = ", ".join(body.name for body in layout.bodies)
        raise ObjectError(f"no tag of known pose on {', '.join(body_names)} (bodies of the scene: {names})")
    return tuple(tags)


def chain(bodies: Sequence[Body], b: int) -> tuple[int, list[int]]:
    """The root of a body's chain of hinges, and the links from there outwards, the body itself last."""
    number = {body.name: i for i, body in enumerate(bodies)}
    links: list[int] = []
    hinge = bodies[b].hinge
    while hinge is not None:
        links.append(b)
        b = number[hinge.parent]
        hinge = bodies[b].hinge
    return b, links[::-1]


def descendants(bodies: Sequence[Body], root: int) -> list[int]:
    """The bodies whose chain of hinges ends at a root, parents first."""
    return [b for b, body in enumerate(bodies) if body.hinge is not None and chain(bodies, b)[0] == root]


def articulated(layout: TagLayout, model: ObjectModel) -> TagLayout:
    """The scene with the object's bodies hung on each other as its model says.

    Raises:
        ObjectError: a body of the object is none of the scene, or slides.
    """
    if model.n_bodies == 1:
        return layout
    root = object_body(layout, model.body_names)
    names = [root.name if root is not None else model.body_names[0], *model.body_names[1:]]
    bodies = {body.name: body for body in layout.bodies}
    missing = [name for name in names if name not in bodies or bodies[name].is_static]
    if missing:
        raise ObjectError(
            f"'{missing[0]}' of object '{model.name}' is no moving body of the scene ({', '.join(bodies)})"
        )
    for b in range(1, model.n_bodies):
        if model.joint_type[b] != JointType.HINGE:
            raise ObjectError(f"'{names[b]}' of object '{model.name}' slides; only hinges can be tracked")
        T = np.eye(4)
        T[:3, :3], T[:3, 3] = quat_to_matrix(model.body_quat[b]), model.body_pos[b]
        hinge = Hinge(names[int(model.parent[b])], T, model.joint_axis[b], model.joint_pos[b])
        bodies[names[b]] = replace(bodies[names[b]], hinge=hinge)
    return replace(layout, bodies=tuple(bodies.values()))
