"""Detections without rendering: a tumbling object's true corners with noise; and poses against the truth."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from tossid.objects import ObjectModel, body_poses
from tossid.rotations import quat_boxminus, quat_exp, quat_mul, quat_normalize, transform, transform_points
from tossid.types import Detection, PoseTrack
from tossid.vision.cameras.camera import Camera
from tossid.vision.setup.faces import tag_corners


def tangent(track_: PoseTrack, q: np.ndarray) -> np.ndarray:
    """True minus estimated configurations in the tangent of the covariance, joints within half a turn. (n, nv)."""
    turn = quat_boxminus(q[:, 3:7], track_.q[:, 3:7])
    joints = (q[:, 7:] - track_.q[:, 7:] + np.pi) % (2 * np.pi) - np.pi
    return np.concatenate([q[:, :3] - track_.q[:, :3], turn, joints], axis=1)


def nees(track_: PoseTrack, q: np.ndarray) -> np.ndarray:
    """Normalised squared errors over their expectation. (n,)."""
    error = tangent(track_, q)
    assert track_.q_cov is not None
    return np.einsum("ni,nij,nj->n", error, np.linalg.inv(track_.q_cov), error) / error.shape[1]


def alike(sigma: float) -> np.ndarray:
    """One covariance for all four corners [px²]. (4, 2, 2)."""
    return np.tile(sigma**2 * np.eye(2), (4, 1, 1))


def seen(
    cameras: Sequence[Camera],
    model: ObjectModel,
    t: float,
    q: np.ndarray,
    rng: np.random.Generator,
    sigma: float,
    facing: float = 0.35,
) -> Iterator[Detection]:
    """Detections of a pose without rendering: true corners with noise, of tags that face a camera."""
    poses = [transform(p, quat) for p, quat in zip(*body_poses(model, q), strict=True)]
    for camera in cameras:
        eye = camera.T_world_cam[:3, 3]
        for tag in model.tags:
            T = poses[tag.body]
            corners = transform_points(T, tag_corners(tag))
            view = eye - corners.mean(axis=0)
            if (T[:3, :3] @ tag.T_body_tag[:3, 2]) @ view > facing * np.linalg.norm(view):
                noise = sigma * rng.normal(size=(4, 2))
                yield Detection(camera.name, t, tag.id, camera.project(corners) + noise, alike(sigma))


def seen_over_time(
    camera: Camera, model: ObjectModel, t: np.ndarray, q: np.ndarray, rng: np.random.Generator, *, late: float = 0.0
) -> list[Detection]:
    """The same by one camera at times t (n,) of a rigid object's configurations q (n, 7); its clock is late [s]."""
    found = []
    for tag in model.tags:
        T = transform(q[:, :3], q[:, 3:7])
        corners = transform_points(T, np.broadcast_to(tag_corners(tag), (len(t), 4, 3)))
        view = camera.T_world_cam[:3, 3] - corners.mean(axis=1)
        facing = np.sum((T[:, :3, :3] @ tag.T_body_tag[:3, 2]) * view, axis=1) > 0.35 * np.linalg.norm(view, axis=1)
        pixels = camera.project(corners) + 0.1 * rng.normal(size=(len(t), 4, 2))
        found += [Detection(camera.name, t[i] + late, tag.id, pixels[i], alike(0.1)) for i in np.flatnonzero(facing)]
    return sorted(found, key=lambda d: d.t)


def motion(n: int, rng: np.random.Generator) -> np.ndarray:
    """A smooth tumble in view."""
    s = np.linspace(0, 1, n)[:, None]
    p = np.array([-0.2, 0.1, 0.25]) + s * [0.4, -0.2, 0.05]
    quat = quat_mul(quat_normalize(rng.normal(size=4)), quat_exp(s * rng.uniform(-5, 5, 3)))
    return np.concatenate([p, quat], axis=1)


def tumble(n: int, rng: np.random.Generator, *, rate_hz: float = 148.0, spin: float = 5.0) -> tuple[np.ndarray, ...]:
    """A continuous tumble about the middle of the view: times (n,), configurations (n, 7)."""
    t = np.arange(n) / rate_hz
    p = [-0.15, 0.1, 0.3] + [0.25, 0.25, 0.12] * np.sin(np.pi * t[:, None] + np.array([0.0, 1.0, 2.0]))
    quat, axis = [quat_normalize(rng.normal(size=4))], rng.normal(size=3)
    for now in t[1:]:
        rate = spin * axis / np.linalg.norm(axis) + 2 * np.sin(3 * now + np.arange(3))
        quat.append(quat_normalize(quat_mul(quat[-1], quat_exp(rate / rate_hz))))
    return t, np.concatenate([p, np.array(quat)], axis=1)


def filmed_tumble(
    cameras: Sequence[Camera], model: ObjectModel, rng: np.random.Generator, *, n: int = 300, sigma: float = 0.1
) -> tuple[list[Detection], np.ndarray]:
    """Detections of a tumble, and its configurations (n, 7), a frame each."""
    t, q = tumble(n, rng)
    return [d for i in range(n) for d in seen(cameras, model, t[i], q[i], rng, sigma)], q
