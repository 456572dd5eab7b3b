"""Centre of mass, static stability, and stillness of configurations."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tossid.objects import ObjectModel, body_poses, corner_positions
from tossid.rotations import geodesic_angle, quat_continuous, quat_normalize, quat_rotate

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]

TOUCHING_REL = 0.05
"""How much higher than the lowest corner others are that touch, in widths of the object."""
HALF_TURN = np.deg2rad(179.5)
"""A body falls over where touching corners leave a wider gap about the centre of mass, seen from above [rad]."""


def center_of_mass(model: ObjectModel, q: Array) -> Array:
    """World position of the whole object's centre of mass [m], (n, 3).

    Args:
        model: The object.
        q: Configurations, (n, nq).
    """
    position, quat = body_poses(model, q)
    com = position + quat_rotate(quat, model.com)
    return np.asarray(np.einsum("b,nbi->ni", model.mass, com) / model.mass.sum())


def touching(model: ObjectModel, q: Array) -> Array:
    """The corners of the stated geometry that touch the ground if one does [m], (k, 3).

    Args:
        model: The object.
        q: Configuration, (nq,).
    """
    corners = corner_positions(model, q)
    return np.asarray(corners[corners[:, 2] < corners[:, 2].min() + TOUCHING_REL * model.width])


def stands(model: ObjectModel, q: Array) -> bool:
    """Whether the centre of mass is above the area between the touching corners.

    Args:
        model: The object.
        q: Configuration, (nq,).
    """
    around = touching(model, q)[:, :2] - center_of_mass(model, q[None])[0, :2]
    angle = np.sort(np.arctan2(around[:, 1], around[:, 0]))
    gaps = np.diff(np.append(angle, angle[0] + 2 * np.pi))
    return bool(gaps.max() < HALF_TURN)


def mean_pose(q: Array) -> Array:
    """Median position and joints and mean orientation of configurations near each other, (nq,).

    Args:
        q: Configurations, (n, nq).
    """
    pose = np.median(q, axis=0)
    pose[3:7] = quat_normalize(quat_continuous(q[:, 3:7]).mean(axis=0))
    return np.asarray(pose)


def near(q: Array, pose: Array, distance: Array | float, angle: Array | float) -> Bools:
    """Which configurations are near a pose, (n,).

    Args:
        q: Configurations, (n, nq).
        pose: The pose, (nq,), or one for each, (n, nq).
        distance: Largest distance [m].
        angle: Largest angle, of joints too [rad].
    """
    close = np.linalg.norm(q[:, :3] - pose[..., :3], axis=1) < distance
    turned = geodesic_angle(q[:, 3:7], pose[..., 3:7]) < angle
    joints = (np.abs(q[:, 7:] - pose[..., 7:]) < np.asarray(angle)[..., None]).all(axis=1)
    return np.asarray(close & turned & joints)


def still_for(q: Array, span: int, distance: Array | float, angle: Array | float) -> Bools:
    """Frames whose pose is the same half of `span` and `span` frames later, (n - span,).

    Args:
        q: Configurations, (n, nq).
        span: Number of frames.
        distance: What is the same [m].
        angle: What is the same [rad].
    """
    count = len(q) - span
    half, whole = (near(q[step : count + step], q[:count], distance, angle) for step in (span // 2, span))
    return np.asarray(half & whole)
