"""Tosses with one impact of one instant, whose time, poses and velocities are known exactly."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tossid.objects import ObjectModel, corner_positions
from tossid.rotations import quat_exp, quat_mul, quat_normalize
from tossid.types import PoseTrack

GRAVITY = 9.81
STEPS = 8
"""Steps of a frame in which the rotation of a body that tumbles is integrated, by the midpoint rule."""


@dataclass(frozen=True)
class Bounced:
    """A toss, and the number of its last frame before the impact."""

    track: PoseTrack
    last: int


def bounced(
    model: ObjectModel,
    rng: np.random.Generator,
    *,
    name: str = "toss",
    rate_hz: float = 250.0,
    before: int = 12,
    after: int = 14,
    noise: float = 0.0,
    planar: bool = False,
) -> Bounced:
    """A toss that flies, hits the ground with one corner at a random time between two frames, and flies on.

    Args:
        model: The object, with its centre of mass at its origin.
        rng: Draws pose, velocities and time.
        name: Of the toss.
        rate_hz: Frames a second.
        before: Frames before the impact.
        after: Frames after it.
        noise: Standard deviation of positions [m]; of angles, ten times as much [rad].
        planar: Whether all motion is in the x-z plane.
    """
    flat = np.array([0.0, 1.0, 0.0]) if planar else np.ones(3)
    while True:
        quat = quat_exp(rng.uniform(-np.pi, np.pi) * flat) if planar else quat_normalize(rng.normal(size=4))
        pose = np.concatenate([[0.0, 0.0, 0.0], quat])
        pose[2] -= corner_positions(model, pose)[:, 2].min()
        sideways = rng.normal(size=(2, 3)) * [0.4, 0.0 if planar else 0.4, 0.0]
        u = sideways + np.array([[0, 0, -rng.uniform(1.5, 3.0)], [0, 0, rng.uniform(0.7, 1.5)]])
        w = rng.normal(size=(2, 3)) * 5.0 * flat
        w[1] += 10.0 * flat * rng.normal(size=3)
        late = rng.uniform(0.05, 0.95)
        past, future = -(np.arange(before) + late)[::-1] / rate_hz, (np.arange(after) + 1 - late) / rate_hz
        q = np.concatenate([flight(model, pose, u[0], w[0], past[::-1])[::-1], flight(model, pose, u[1], w[1], future)])
        if corner_positions(model, q)[..., 2].min() > 0:
            break
    n = len(q)
    q[:, :3] += rng.normal(size=(n, 3)) * noise
    q[:, 3:7] = quat_mul(q[:, 3:7], quat_exp(rng.normal(size=(n, 3)) * 10 * noise))
    return Bounced(PoseTrack(name, np.arange(n) / rate_hz, q), before - 1)


def flight(model: ObjectModel, pose: np.ndarray, u: np.ndarray, w: np.ndarray, t: np.ndarray) -> np.ndarray:
    """Poses (n, 7) at times (n,), ever farther from 0, of a body that flies freely through a pose at time 0.

    Args:
        model: The body, with its centre of mass at its origin.
        pose: (7,) at time 0.
        u: (3,) velocity there [m/s].
        w: (3,) spin there, in the body's frame [rad/s].
        t: Times [s].
    """
    I, quat, at, out = model.inertia[0], pose[3:7], 0.0, []
    steps = 1 if np.allclose(I, I[0, 0] * np.eye(3)) else STEPS
    for time in t:
        h = (time - at) / steps
        for _ in range(steps):
            middle = w + 0.5 * h * np.linalg.solve(I, np.cross(I @ w, w))
            quat = quat_mul(quat, quat_exp(h * middle))
            w = w + h * np.linalg.solve(I, np.cross(I @ middle, middle))
        at = time
        out.append(np.concatenate([pose[:3] + u * time - [0, 0, 0.5 * GRAVITY * time**2], quat]))
    return np.array(out)


def without(track: PoseTrack, frames: list[int]) -> tuple[PoseTrack, np.ndarray]:
    """The track without some frames and without gaps in its times, and the true times of what is left.

    Args:
        track: Evenly timed.
        frames: Numbers of the frames that are lost.
    """
    q, true = np.delete(track.q, frames, axis=0), np.delete(track.t, frames)
    return PoseTrack(track.name, track.t[: len(q)], q), true
