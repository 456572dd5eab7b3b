"""A hand that gets in the way: it holds the object until the release, or reaches through a camera's view."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tossid.objects import ObjectModel
from tossid.rotations import quat_exp, quat_mul, rotvec_to_matrix
from tossid.vision.cameras.camera import Camera
from tossid.vision.setup.faces import Face, plane_axes

Array = NDArray[np.float64]

SKIN, SLEEVE = 150.0, 70.0
"""Grey levels of the hand and of the forearm at full light."""
APPROACH_TIME, ACCELERATION = 0.2, 12.0
"""Time that the hand takes to come or go [s], and the upward acceleration with which it leaves the object [m/s²]."""
SWEEP_DISTANCE, SWEEP_SPEED = 0.22, 2.2
"""Distance from the object at which it passes through a view [m], and its speed there [m/s]."""


@dataclass(frozen=True, slots=True)
class Reach:
    """A stretch of time with a hand in the scene.

    Attributes:
        kind: "holds" or "sweeps".
        t0: Its beginning [s].
        t1: Its end [s].
        camera: Camera in whose view it sweeps.
    """

    kind: str
    t0: float
    t1: float
    camera: str | None = None


def hand_faces(model: ObjectModel, *, body: int) -> tuple[tuple[Face, ...], Array]:
    """A palm, fingers and a forearm around an object's base, made of boxes, and their grey levels.

    The hand's frame is at the middle of its grip, z toward the arm.

    Returns:
        Its faces (f), and their grey levels (f,) at full light.
    """
    corners = model.drawn.corner_pos[model.drawn.corner_body == 0]
    half = 0.5 * np.ptp(corners, axis=0)
    r = 0.5 * float(half.min() + np.linalg.norm(half))
    tilt = np.array([0.0, -0.5, 0.0])  # the forearm leans away from the fingers
    arm = np.array([0.0, 0.0, r + 0.03]) + rotvec_to_matrix(tilt) @ [0.0, 0.0, 0.17]
    boxes = [
        ([0.0, 0.0, r + 0.015], [2 * r + 0.02, 0.085, 0.03], np.zeros(3), SKIN),
        ([r + 0.01, -0.03, 0.25 * r], [0.018, 0.02, 1.5 * r], np.zeros(3), SKIN),
        ([r + 0.01, 0.0, 0.2 * r], [0.018, 0.02, 1.6 * r], np.zeros(3), SKIN),
        ([r + 0.01, 0.03, 0.3 * r], [0.018, 0.02, 1.4 * r], np.zeros(3), SKIN),
        ([-r - 0.01, 0.01, 0.35 * r], [0.02, 0.024, 1.3 * r], np.zeros(3), SKIN),
        (arm, [0.07, 0.08, 0.34], tilt, SLEEVE),
    ]
    faces, levels = [], []
    for center, size, turn, level in boxes:
        R = rotvec_to_matrix(turn)
        for axis in range(3):
            for sign in (1.0, -1.0):
                local = np.zeros(3)
                local[axis] = sign
                u, v = plane_axes(local)
                at = 0.5 * np.asarray(size) * local
                du, dv = 0.5 * abs(np.asarray(size) @ u) * u, 0.5 * abs(np.asarray(size) @ v) * v
                polygon = at + np.stack([-du - dv, du - dv, du + dv, -du + dv])
                faces.append(Face(body, np.asarray(center) + polygon @ R.T, R @ local, np.asarray(center) + R @ at))
                levels.append(level)
    return tuple(faces), np.array(levels)


def hand_poses(
    t: Array,
    q: Array,
    *,
    lift: NDArray[np.int64],
    release: NDArray[np.int64],
    rest: NDArray[np.int64],
    holds: bool,
    sweeps: float,
    cameras: Sequence[Camera],
    rng: np.random.Generator,
) -> tuple[Array, tuple[Reach, ...]]:
    """Where the hand is in each frame, and when there is one.

    A hand that holds comes from above before it lifts the object, follows it, upright and with fingers that
    let it turn, and goes up and away from the release on. A hand that sweeps passes between the object and one of
    the cameras at some time between release and rest.

    Args:
        t: (n,) even times [s].
        q: (n, nq) the object's configurations.
        lift: (m,) frame of each toss at which the object is lifted.
        release: (m,) frame at which it is let go.
        rest: (m,) frame from which it rests.
        holds: Whether a hand holds it before each release.
        sweeps: Share of the tosses with a hand that sweeps, 0 to 1.
        cameras: Whose views a hand may sweep through.
        rng: Source of directions, times and cameras.

    Returns:
        (n, 7) position [m] and quaternion, NaN where there is none; its stretches in order of time.
    """
    poses = np.full((len(t), 7), np.nan)
    reaches = []
    for begin, let_go, end in zip(lift, release, rest, strict=True):
        yaw = quat_exp([0.0, 0.0, rng.uniform(0, 2 * np.pi)])
        sweeping, share = rng.random() < sweeps, rng.random()
        camera = cameras[int(rng.integers(len(cameras)))]
        if holds:
            before = np.flatnonzero((t > t[begin] - APPROACH_TIME) & (t < t[begin]))
            after = np.flatnonzero((t >= t[let_go]) & (t < t[let_go] + APPROACH_TIME))
            v = (q[let_go, :3] - q[let_go - 1, :3]) / (t[let_go] - t[let_go - 1])
            up = np.array([0.0, 0.0, 0.5 * ACCELERATION])
            poses[before, :3] = q[begin, :3] + up * ((t[before] - t[begin]) ** 2)[:, None]
            poses[begin:let_go, :3] = q[begin:let_go, :3]
            s = (t[after] - t[let_go])[:, None]
            poses[after, :3] = q[let_go, :3] + v * s + up * s**2
            poses[begin - len(before) : let_go + len(after), 3:] = yaw
            reaches.append(Reach("holds", float(t[begin - len(before)]), float(t[let_go + len(after) - 1])))
        if sweeping:
            middle = int(let_go + share * (end - let_go))
            poses, reach = _sweep(poses, t, q[middle, :3], t[middle], t[let_go] + APPROACH_TIME, camera)
            reaches.append(reach)
    return poses, tuple(sorted(reaches, key=lambda reach: reach.t0))


def _sweep(poses: Array, t: Array, at: Array, when: float, earliest: float, camera: Camera) -> tuple[Array, Reach]:
    """A hand passes a point on its way to a camera, crosswise to that; not before the time that it let go at."""
    toward = camera.T_world_cam[:3, 3] - at
    toward /= np.linalg.norm(toward)
    across = np.cross([0.0, 0.0, 1.0], toward)
    across /= np.linalg.norm(across)
    own = np.flatnonzero((np.abs(t - when) < 0.45 / SWEEP_SPEED) & (t >= earliest))
    if not len(own):
        return poses, Reach("sweeps", when, when, camera.name)
    way = SWEEP_SPEED * (t[own] - when)
    poses[own, :3] = at + SWEEP_DISTANCE * toward + way[:, None] * across
    # the arm points the way it comes from
    along = np.array([across[0], across[1], 0.0])
    turn = quat_mul(quat_exp([0.0, 0.0, np.arctan2(along[1], along[0])]), quat_exp([0.0, -np.pi / 2, 0.0]))
    poses[own, 3:] = turn
    return poses, Reach("sweeps", float(t[own[0]]), float(t[own[-1]]), camera.name)
