"""A default set of cameras around the place where the object lands."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tossid.errors import InputError
from tossid.rotations import transform_points
from tossid.vision.cameras.camera import Camera

Array = NDArray[np.float64]


def look_at(position: ArrayLike, target: ArrayLike) -> Array:
    """The pose T_world_cam (4, 4) of a camera at a position [m] that looks at a target [m], its x axis level."""
    position, target = np.asarray(position, dtype=float), np.asarray(target, dtype=float)
    forward = target - position
    forward /= np.linalg.norm(forward)
    right = np.cross(forward, [0.0, 0.0, 1.0])
    if np.linalg.norm(right) < 1e-9:
        raise InputError("a camera that looks straight up or down has no level x axis")
    right /= np.linalg.norm(right)
    T = np.eye(4)
    T[:3, :3] = np.stack([right, np.cross(forward, right), forward], axis=1)
    T[:3, 3] = position
    return T


def default_rig(
    *,
    n_cameras: int = 3,
    resolution: tuple[int, int] = (640, 512),
    rate_hz: float = 148.0,
    area: float = 1.2,
    height: float = 0.45,
    distance: float = 1.5,
    elevation_deg: float = 38.0,
    distorted: bool = True,
) -> tuple[Camera, ...]:
    """Cameras evenly around the toss area, each seeing all of it.

    The area is a disc of diameter `area` [m] on the ground z = 0 about the
    origin, up to `height` [m]. Focal lengths are the longest that still hold it.

    Args:
        n_cameras: How many, 1 to 9.
        resolution: (width, height) [px].
        rate_hz: Frames a second.
        area: Diameter of the toss area [m].
        height: Up to which each camera sees the area [m].
        distance: From the middle of the area to each camera [m].
        elevation_deg: Elevation of the cameras over the ground [deg].
        distorted: Whether they have mild radtan distortion, a little different for each camera.

    Returns:
        The cameras, placed in the world.

    Raises:
        InputError: There are too many, or one stands inside the area.
    """
    if not 1 <= n_cameras <= 9:
        raise InputError(f"a default rig has 1 to 9 cameras, not {n_cameras}")
    turn = np.linspace(0, 2 * np.pi, 24, endpoint=False)
    ring = 0.5 * area * np.stack([np.cos(turn), np.sin(turn)], axis=-1)
    volume = np.concatenate([np.column_stack([ring, np.full(24, z)]) for z in (0.0, height)])
    target = np.array([0.0, 0.0, 0.4 * height])
    cameras = []
    for index in range(n_cameras):
        azimuth = np.deg2rad(20.0) + 2 * np.pi * index / n_cameras
        elevation = np.deg2rad(elevation_deg + 4.0 * (index % 2))
        direction = [np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)]
        T_world_cam = look_at(target + distance * np.asarray(direction), target)
        seen = transform_points(np.linalg.inv(T_world_cam), volume)
        slope = seen[:, :2] / seen[:, 2:]
        if (seen[:, 2] <= 0).any():
            raise InputError(f"a camera {distance} m away stands inside the toss area")
        low, high = slope.min(axis=0), slope.max(axis=0)
        focal = float(np.min(0.98 * np.asarray(resolution) / (high - low)))
        center = (np.asarray(resolution) - 1) / 2 - focal * (low + high) / 2
        k = np.array([-0.11 - 0.01 * (index % 3), 0.06, 0.0004 * (-1) ** index, -0.0003]) if distorted else np.zeros(4)
        cameras.append(
            Camera(
                name=f"cam{index}",
                resolution=resolution,
                intrinsics=np.array([focal, focal * 1.001, *center]),
                distortion_model="radtan",
                distortion=k,
                T_rig_cam=T_world_cam,
                rate_hz=rate_hz,
            )
        )
    return tuple(cameras)
