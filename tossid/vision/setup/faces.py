"""What the cameras look at: the flat faces of an object's bodies, and the tags on them."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull

from tossid.errors import ObjectError
from tossid.objects import ObjectModel, Tag
from tossid.vision.setup.layout import SQUARE, BodyTag

Array = NDArray[np.float64]

TAG_CELLS = 8
"""Cells across a 36h11 tag, black border included."""
TAG_FILL = 0.08 / 0.1048
"""Black border edge over face width of the cube of the real recordings."""
FLAT = 2e-3
"""Distance of a tag's corners from the face that it lies on [m]."""
FAMILY_SIZE = 587
"""Number of codes in 36h11."""


@dataclass(frozen=True, eq=False)
class Face:
    """A flat face.

    Attributes:
        body: Number of its body.
        polygon: (k, 3) corners in the body's frame [m], counter-clockwise from outside.
        normal: (3,) unit, outward.
        center: (3,) mean of the corners [m].
    """

    body: int
    polygon: Array
    normal: Array
    center: Array


def object_faces(model: ObjectModel) -> tuple[Face, ...]:
    """The faces of each body's convex hull, ordered by body, then +x, -x, +y, -y, +z, -z."""
    faces: list[Face] = []
    for body in range(model.n_bodies):
        corners = model.drawn.corner_pos[model.drawn.corner_body == body]
        if len(corners):
            faces += sorted(_hull_faces(body, corners), key=_direction)
    return tuple(faces)


def _hull_faces(body: int, corners: Array) -> list[Face]:
    hull = ConvexHull(corners)
    size = float(np.ptp(corners, axis=0).max())
    faces: list[Face] = []
    for equation in hull.equations:
        normal = equation[:3]
        if any(normal @ face.normal > 1 - 1e-9 for face in faces):
            continue
        own = corners[np.abs(corners @ normal + equation[3]) < 1e-6 * size]
        center = own.mean(axis=0)
        u, v = plane_axes(normal)
        angle = np.arctan2((own - center) @ v, (own - center) @ u)
        faces.append(Face(body, own[np.argsort(angle)], normal.copy(), center))
    return faces


def _direction(face: Face) -> tuple[int, float, float, float]:
    axis = int(np.argmax(np.round(np.abs(face.normal), 6)))
    x, y, z = np.round(face.normal, 6)
    return axis, -float(np.sign(face.normal[axis])), -float(x + 2 * y), -float(z)


def plane_axes(normal: Array) -> tuple[Array, Array]:
    """Right and up of a viewer in front of a plane: up is +z, or +y where the plane faces up or down.

    (3,) -> (3,), (3,) with right × up = normal.
    """
    up = np.array([0.0, 0.0, 1.0]) if abs(normal[2]) < 0.9 else np.array([0.0, 1.0, 0.0])
    right = np.cross(up, normal)
    right /= np.linalg.norm(right)
    return right, np.cross(normal, right)


def default_tags(model: ObjectModel, *, first_id: int = 0) -> tuple[Tag, ...]:
    """One tag centred on each face, upright, with ids counted from `first_id`.

    The cube gets six tags of 0.08 m, ids 0 to 5 on +x, -x, +y, -y, +z, -z.
    """
    tags = []
    for index, face in enumerate(object_faces(model)):
        right, up = plane_axes(face.normal)
        flat = np.stack([(face.polygon - face.center) @ right, (face.polygon - face.center) @ up], axis=-1)
        edge = np.roll(flat, -1, axis=0) - flat
        outward = np.stack([edge[:, 1], -edge[:, 0]], axis=-1)
        # the square |x|, |y| <= h lies inside an edge where h (|n_x| + |n_y|) <= distance
        half = float(np.min(np.sum(outward * flat, axis=1) / np.abs(outward).sum(axis=1)))
        T = np.eye(4)
        T[:3, :3] = np.stack([right, up, face.normal], axis=1)
        T[:3, 3] = face.center
        tags.append(Tag(first_id + index, TAG_FILL * 2 * half, face.body, T))
    return tuple(tags)


def tag_corners(tag: Tag | BodyTag) -> Array:
    """The corners (4, 3) of a tag's black border in its body's frame [m].

    Bottom-left, bottom-right, top-right, top-left, as a viewer sees the upright tag.
    """
    assert tag.T_body_tag is not None
    return np.asarray(0.5 * tag.size * SQUARE @ tag.T_body_tag[:3, :3].T + tag.T_body_tag[:3, 3])


def tag_bitmap(tag_id: int) -> NDArray[np.uint8]:
    """The 36h11 code as an 8 by 8 picture, 0 black and 1 white, first row at the top.

    OpenCV draws this family turned by half a turn against the AprilTag library's corner order.
    """
    if not 0 <= tag_id < FAMILY_SIZE:
        raise ObjectError(f"tag id {tag_id} is not in 36h11 (0 to {FAMILY_SIZE - 1})")
    family = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)
    picture = cv2.aruco.generateImageMarker(family, tag_id, TAG_CELLS)
    return np.ascontiguousarray(np.rot90(picture, 2) > 127).astype(np.uint8)


def face_of_tag(tag: Tag, faces: tuple[Face, ...]) -> int:
    """Index of the face that a tag lies on.

    Raises:
        ObjectError: no face of its body is within `FLAT` of all its corners.
    """
    corners = tag_corners(tag)
    for index, face in enumerate(faces):
        if face.body != tag.body or tag.T_body_tag[:3, 2] @ face.normal < 0.99:
            continue
        if np.abs((corners - face.center) @ face.normal).max() < FLAT:
            return index
    raise ObjectError(f"tag {tag.id} lies on no flat face of body {tag.body}, so it cannot be drawn")
