"""Detections without rendering, their tracks, and poses against the truth."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence

import numpy as np

from tossid.objects import ObjectModel, body_poses
from tossid.rotations import (
    geodesic_angle,
    matrix_to_quat,
    quat_boxminus,
    quat_exp,
    quat_mul,
    quat_normalize,
    transform,
    transform_points,
)
from tossid.settings.tracking import TrackSettings
from tossid.types import Detection, PoseTrack
from tossid.vision.cameras.camera import Camera
from tossid.vision.pose_graph.report import TrackReport
from tossid.vision.pose_graph.track import DEFAULT, track_scene
from tossid.vision.setup.faces import tag_corners
from tossid.vision.setup.layout import Body, BodyTag, TagLayout, articulated, layout_of


def tangent(track_: PoseTrack, q: np.ndarray) -> np.ndarray:
    """True minus estimated configurations in the tangent of the covariance, joints within half a turn. (n, nv)."""
    turn = quat_boxminus(q[:, 3:7], track_.q[:, 3:7])
    joints = (q[:, 7:] - track_.q[:, 7:] + np.pi) % (2 * np.pi) - np.pi
    return np.concatenate([q[:, :3] - track_.q[:, :3], turn, joints], axis=1)


def nees(track_: PoseTrack, q: np.ndarray) -> np.ndarray:
    """Normalised squared errors over their expectation. (n,)."""
    error = tangent(track_, q)
    return np.einsum("ni,nij,nj->n", error, np.linalg.inv(track_.q_cov), error) / error.shape[1]


def alike(sigma: float) -> np.ndarray:
    """One covariance for all four corners [px²]. (4, 2, 2)."""
    return np.tile(sigma**2 * np.eye(2), (4, 1, 1))


def sights(
    cameras: Sequence[Camera],
    model: ObjectModel,
    t: np.ndarray,
    q: np.ndarray,
    rng: np.random.Generator,
    *,
    sigma: float = 0.1,
    late: float = 0.0,
) -> Iterator[Detection]:
    """Detections without rendering, in order of time, made as they are asked for.

    They are the true corners, with noise, of the tags that face a camera, at times t (n,) of configurations q (n, nq);
    the cameras' clocks are late [s].
    """
    for part in np.array_split(np.arange(len(t)), len(t) // 100 + 1):
        position, quat = body_poses(model, q[part])
        found = []
        for camera in cameras:
            for tag in model.tags:
                T = transform(position[:, tag.body], quat[:, tag.body])
                corners = transform_points(T, np.broadcast_to(tag_corners(tag), (len(part), 4, 3)))
                view = camera.T_world_cam[:3, 3] - corners.mean(axis=1)
                facing = np.sum((T[:, :3, :3] @ tag.T_body_tag[:3, 2]) * view, axis=1)
                pixels = camera.project(corners) + sigma * rng.normal(size=(len(part), 4, 2))
                for i in np.flatnonzero(facing > 0.35 * np.linalg.norm(view, axis=1)):
                    found.append(Detection(camera.name, float(t[part[i]]) + late, tag.id, pixels[i], alike(sigma)))
        yield from sorted(found, key=lambda d: d.t)


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
    return list(sights(cameras, model, t, q, rng, sigma=sigma)), q


def track(
    detections: Iterable[Detection], cameras: Sequence[Camera], model: ObjectModel, *, settings: TrackSettings = DEFAULT
) -> tuple[PoseTrack, TrackReport]:
    """The track of one object whose tags are where its model says, among cameras of known pose, and a report."""
    layout = articulated(layout_of(model), model)
    tracked = track_scene(list(detections), cameras, layout, settings=settings)
    return tracked.tracks[model.body_names[0]], tracked.report


def wall(rng: np.random.Generator, *, noise: float = 0.0) -> tuple[list[Detection], list[Camera], TagLayout]:
    """A camera before a wall of four tags, one of them known: a metre apart."""
    camera = Camera("cam0", (1280, 1024), [900, 900, 640, 512], rig_body="rig", T_world_rig=None)
    places = [transform(np.array([x, y, 3.0]), np.array([0.0, 1, 0, 0])) for x in (-0.5, 0.5) for y in (-0.4, 0.4)]
    known = BodyTag(0, 0.2, places[0])
    lab = Body("lab", True, np.eye(4), 0.2, (known, *(BodyTag(i, 0.2, None) for i in (1, 2, 3))))
    detections = []
    square = 0.1 * np.array([[-1.0, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]])
    for i in range(30):
        T = transform(np.array([0.3, 0.2, 0.5]) * np.sin(i / 4 + np.arange(3)), np.array([1.0, 0, 0, 0]))
        for tag_id, place in enumerate(places):
            world = square @ place[:3, :3].T + place[:3, 3]
            pixels = camera.distort((world - T[:3, 3]) @ T[:3, :3])[0] + noise * rng.normal(size=(4, 2))
            detections.append(Detection("cam0", i / 10, tag_id, pixels, alike(max(noise, 0.1))))
    return detections, [camera], TagLayout((lab, Body("rig", False)))


def apart(A: np.ndarray, B: np.ndarray) -> tuple[float, float]:
    """Distance [mm] and angle [degrees] of two poses."""
    turn = geodesic_angle(matrix_to_quat(A[:3, :3]), matrix_to_quat(B[:3, :3]))
    return 1e3 * float(np.linalg.norm(A[:3, 3] - B[:3, 3])), float(np.rad2deg(turn))
