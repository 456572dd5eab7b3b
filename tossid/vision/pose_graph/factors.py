"""The pose graph's factors: what a camera saw of a body in one frame, and measured lengths (GTSAM, Numba)."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, NamedTuple

import gtsam
import numpy as np
from numpy.typing import NDArray

from tossid.kernels import kernel, part_kernel
from tossid.vision.pose_graph.corner_projection import HUBER, project_tag
from tossid.vision.setup.hinge import Hinge, stacked, swing
from tossid.vision.setup.layout import SQUARE, Measurement

Array = NDArray[np.float64]
Ints = NDArray[np.int64]


@dataclass(eq=False)
class Noise:
    """Noise of the corners, shared by all factors and set between optimisations.

    Attributes:
        scale: Standard deviation of corners over what their covariances say.
        spread_sigma: Standard deviation of the spread of tags' edges, over `scale` [px].
    """

    scale: float = 1.0
    spread_sigma: float = 0.0


@dataclass(frozen=True, slots=True)
class TagModel:
    """How tags differ from flat squares with sharp edges.

    Attributes:
        spread_sigma: Standard deviation by which a tag's edges spread from image to image, over the noise's scale [px].
        prints: Numbers of the tags whose prints are variables.
    """

    spread_sigma: float = 0.0
    prints: frozenset[int] = frozenset()


IDEAL_TAGS = TagModel()


@dataclass(frozen=True, eq=False)
class View:
    """What one camera saw of one body in one frame: m tags.

    Attributes:
        camera: Key of T_rig_cam.
        rig: Key of T_world_rig.
        body: Key of T_world_body, or of its root if it hangs on another body.
        tags: Key of each sighting's T_body_tag, (m,).
        half: Half of each tag's size [m], (m,).
        seen: As in `Scene`, (m, 4, 2).
        whiten: As in `Scene`, (m, 4, 2, 2).
        count: As in `Scene`, (m,).
        delay: Time of the frame after its step's [s].
        rig_twist: Motion of the rig (rotation [rad/s], translation [m/s], in its own frame), (6,).
        body_twist: Motion of the body, likewise, (6,).
        clock: Key of the camera's clock offset [s]; None where that is no variable.
        joints: Of a body that hangs on others: keys of the angles from the root outward, with their hinges.
        edge_growth: As in `Scene`, (m, 4, 2); None for zero.
        prints: By the key of a tag's pose, its print as `State.prints` has it, and the print's key if it is a variable.
    """

    camera: int
    rig: int
    body: int
    tags: tuple[int, ...]
    half: Array
    seen: Array
    whiten: Array
    count: Array
    delay: float
    rig_twist: Array
    body_twist: Array
    clock: int | None = None
    joints: tuple[tuple[int, Hinge], ...] = ()
    edge_growth: Array | None = None
    prints: dict[int, tuple[Array, int | None]] = field(default_factory=dict)


class _Tags(NamedTuple):
    """The m sightings of a view, as its kernel takes them: half, seen, whiten and edge_growth as in `View`.

    tag_slot: place of each sighting's tag among the chain's tags, (m,). limit: Huber's threshold of each, (m,).
    """

    tag_slot: Ints
    half: Array
    seen: Array
    whiten: Array
    edge_growth: Array
    limit: Array


def view_factor(view: View, fixed: dict[int, Array], noise: Noise) -> gtsam.CustomFactor:
    """Whitened reprojection errors of a view's corners, as a factor of every pose between camera and tag that varies.

    x_cam = T_rig_cam⁻¹ · (T_world_rig M_rig(δ))⁻¹ · T_world_body M_body(δ) · T_body_tag · x_tag, where M(δ) is the
    motion from the step to the frame's own time δ after it, and T_world_body = T_world_root · T(θ₁) · … of a body that
    hangs on others. Huber's loss ρ is in the residual itself, r √(2ρ(|r|))/|r|, so that GTSAM's error is the robust one
    and its gradient exact. Corners of a tag whose edges spread by b ~ N(0, σ²) have the covariance I + σ² g gᵀ, g being
    their whitened motion by b; its inverse root whitens them.

    Args:
        view: What was seen.
        fixed: Poses (4, 4) that are no variables, by key.
        noise: Of the corners; read in each evaluation.
    """
    tags = list(dict.fromkeys(view.tags))
    chain = [view.camera, view.rig, view.body, *tags]
    slot_of = {key: slot for slot, key in enumerate(chain)}
    tag_slot = np.array([tags.index(key) for key in view.tags], dtype=np.int64)
    free = list(dict.fromkeys(key for key in chain if key not in fixed))
    slots = [slot_of[key] for key in free]
    poses = np.stack([fixed.get(key, np.eye(4)) for key in chain])
    rows = 8 * len(view.tags)
    edge_growth = np.zeros_like(view.seen) if view.edge_growth is None else view.edge_growth
    seen = _Tags(tag_slot, view.half, view.seen, view.whiten, edge_growth, HUBER * np.sqrt(view.count))
    joints, hinges = [key for key, _ in view.joints], stacked([hinge for _, hinge in view.joints])
    first_joint = len(free) + (view.clock is not None)
    printed = [(tags.index(tag), key) for tag, (_, key) in view.prints.items() if key is not None]
    as_given = np.zeros((len(tags) if view.prints else 0, 3))
    for tag, (values, _) in view.prints.items():
        as_given[tags.index(tag)] = values

    def error(_: Any, values: gtsam.Values, H: list[Array] | None) -> Array:
        here = poses.copy()
        for key, slot in zip(free, slots, strict=True):
            here[slot] = values.atPose3(key).matrix()
        by_joints = np.zeros((0, 0))
        if joints:
            here[2], by_joints = swing(here[2], *hinges, np.array([values.atDouble(key) for key in joints]))
        prints = as_given.copy()
        for slot, key in printed:
            prints[slot] = values.atPoint3(key)
        delay = view.delay - (values.atDouble(view.clock) if view.clock is not None else 0.0)
        r, J = _reproject(here, prints, seen, delay, view.rig_twist, view.body_twist, noise.scale, noise.spread_sigma)
        if H is not None:
            if joints:
                by = J[2] @ by_joints
                J[2] = by[:, :6]
                for i in range(len(joints)):
                    H[first_joint + i] = by[:, 6 + i : 7 + i]
            for i, slot in enumerate(slots):
                H[i] = J[slot]
            if view.clock is not None:
                H[len(slots)] = -J[len(chain)][:, :1]
            for i, (slot, _) in enumerate(printed):
                H[first_joint + len(joints) + i] = J[len(chain) + 1 + slot][:, :3]
        return r

    keys = free + ([view.clock] if view.clock is not None else []) + joints + [key for _, key in printed]
    return gtsam.CustomFactor(gtsam.noiseModel.Unit.Create(rows), keys, error)


@part_kernel
def _motion(twist: Array, delay: float) -> Array:
    """M(δ) = (exp(ω δ), v δ), as `resect.retract` has it."""
    T = np.eye(4)
    w = twist[:3] * delay
    angle2 = w[0] * w[0] + w[1] * w[1] + w[2] * w[2]
    angle = np.sqrt(angle2)
    a = np.sin(angle) / angle if angle > 1e-8 else 1.0
    b = (1 - np.cos(angle)) / angle2 if angle > 1e-8 else 0.5
    K = np.array([[0.0, -w[2], w[1]], [w[2], 0.0, -w[0]], [-w[1], w[0], 0.0]])
    T[:3, :3] += a * K + b * (K @ K)
    for i in range(3):
        T[i, 3] = twist[3 + i] * delay
    return T


@part_kernel
def _inverse(T: Array) -> Array:
    """The inverse of a rigid transform."""
    out = np.eye(4)
    for i in range(3):
        for j in range(3):
            out[i, j] = T[j, i]
            out[i, 3] -= T[j, i] * T[j, 3]
    return out


@part_kernel
def _carry(J: Array, X: Array, sign: float, out: Array) -> None:
    """out = sign · J Ad(X⁻¹): a derivative (n, 6) by a tangent, carried back over X to the tangent before it.

    T exp(ξ) X = T X exp(Ad(X⁻¹) ξ), with Ad(X⁻¹) = [Rᵀ, 0; -Rᵀ p^, Rᵀ] of X = (R, p).
    """
    for i in range(len(J)):
        for j in range(3):
            out[i, j] = sign * (J[i, 0] * X[j, 0] + J[i, 1] * X[j, 1] + J[i, 2] * X[j, 2])
            out[i, 3 + j] = sign * (J[i, 3] * X[j, 0] + J[i, 4] * X[j, 1] + J[i, 5] * X[j, 2])
        a, b, c = out[i, 3], out[i, 4], out[i, 5]
        out[i, 0] += X[1, 3] * c - X[2, 3] * b
        out[i, 1] += X[2, 3] * a - X[0, 3] * c
        out[i, 2] += X[0, 3] * b - X[1, 3] * a


@part_kernel
def _rate(T: Array, twist: Array) -> Array:
    """Tangent of M(δ) by δ: (ω, Rᵀ v)."""
    out = twist.copy()
    for i in range(3):
        out[3 + i] = T[0, i] * twist[3] + T[1, i] * twist[4] + T[2, i] * twist[5]
    return out


@kernel
def _reproject(
    poses: Array,
    prints: Array,
    tags: _Tags,
    delay: float,
    rig_twist: Array,
    body_twist: Array,
    scale: float,
    spread_sigma: float,
) -> tuple[Array, Array]:
    """Robust whitened residuals (8 m,), and their derivatives (chain + 1 + tags, 8 m, 6).

    The derivatives are by the tangent of each pose of the chain, by the frame's delay, and by the print of each tag.
    All of them are the derivative by T_cam_tag's own tangent, carried back along the chain.
    """
    m, n = len(tags.tag_slot), len(poses)
    r, J = np.zeros(8 * m), np.zeros((n + 1 + len(prints), 8 * m, 6))
    x, flat, J_corner = np.empty((4, 3)), np.empty((4, 2)), np.empty((4, 2, 6))
    g, J_tag, part = np.empty(8), np.empty((8, 6)), np.empty((8, 6))
    M_body, M_rig = _motion(body_twist, delay), _motion(rig_twist, delay)
    T_cam_rig, M_back, T_rig_body = _inverse(poses[0]), _inverse(M_rig), _inverse(poses[1]) @ poses[2]
    body_rate, rig_rate = _rate(M_body, body_twist), _rate(M_rig, rig_twist)
    for d in range(m):
        slot, half = tags.tag_slot[d], tags.half[d]
        p = prints[slot] if len(prints) else np.zeros(3)
        for c in range(4):
            sx, sy = SQUARE[c, 0] * half, SQUARE[c, 1] * half
            x[c, 0], x[c, 1], x[c, 2] = (1 + p[0]) * sx, (1 + p[1]) * sy, p[2] * SQUARE[c, 0] * sy
        T_body_tag = poses[3 + slot]
        T_late_tag = M_body @ T_body_tag
        T_rig_tag = T_rig_body @ T_late_tag
        T_late_rig_tag = M_back @ T_rig_tag
        T_cam_tag = T_cam_rig @ T_late_rig_tag
        project_tag(T_cam_tag, x, flat, J_corner)
        own = slice(8 * d, 8 * d + 8)
        for c in range(4):
            W = tags.whiten[d, c] / scale
            e = flat[c] - tags.seen[d, c]
            for i in range(2):
                row = 2 * c + i
                r[8 * d + row] = W[i, 0] * e[0] + W[i, 1] * e[1]
                g[row] = scale * (W[i, 0] * tags.edge_growth[d, c, 0] + W[i, 1] * tags.edge_growth[d, c, 1])
                for k in range(6):
                    J_tag[row, k] = W[i, 0] * J_corner[c, 0, k] + W[i, 1] * J_corner[c, 1, k]
                if np.isnan(e[0]):  # behind the lens: a large constant error
                    r[8 * d + row], g[row] = 1e5, 0.0
                if len(prints):
                    J[n + 1 + slot, 8 * d + row, 0] = J_tag[row, 3] * SQUARE[c, 0] * half
                    J[n + 1 + slot, 8 * d + row, 1] = J_tag[row, 4] * SQUARE[c, 1] * half
                    J[n + 1 + slot, 8 * d + row, 2] = J_tag[row, 5] * SQUARE[c, 0] * SQUARE[c, 1] * half
        _carry(J_tag, T_cam_tag, -1.0, J[0, own])
        _carry(J_tag, T_rig_tag, -1.0, J[1, own])
        _carry(J_tag, T_late_tag, 1.0, J[2, own])
        J[3 + slot, own] = J_tag
        _carry(J_tag, T_body_tag, 1.0, part)  # by M_body, which moves with the delay
        for i in range(8):
            J[n, 8 * d + i, 0] = np.dot(part[i], body_rate)
        _carry(J_tag, T_late_rig_tag, -1.0, part)  # by M_rig, likewise
        for i in range(8):
            J[n, 8 * d + i, 0] += np.dot(part[i], rig_rate)
        if spread_sigma > 0:
            _whiten_spread(r[own], J[:, own], g, spread_sigma)
        _huber(r[own], J[:, own], tags.limit[d])
    return r, J


@part_kernel
def _whiten_spread(r: Array, J: Array, g: Array, spread_sigma: float) -> None:
    """r (8,) and J (n, 8, 6) times (I + σ² g gᵀ)^(-1/2) = I - (1 - 1/√(1 + σ² |g|²)) g gᵀ/|g|²."""
    square = np.dot(g, g)
    share = (1 - 1 / np.sqrt(1 + spread_sigma * spread_sigma * square)) / max(square, 1e-300)
    along = share * np.dot(g, r)
    for i in range(8):
        r[i] -= along * g[i]
    for k in range(len(J)):
        for j in range(6):
            along = 0.0
            for i in range(8):
                along += g[i] * J[k, i, j]
            along *= share
            for i in range(8):
                J[k, i, j] -= along * g[i]


@part_kernel
def _huber(r: Array, J: Array, limit: float) -> None:
    """r (8,) scaled by √(2ρ(|r|))/|r| corner by corner, ρ being Huber's loss, and J (n, 8, 6) so that Jᵀr is exact."""
    for c in range(4):
        size = np.sqrt(r[2 * c] ** 2 + r[2 * c + 1] ** 2)
        if size > limit:
            value = np.sqrt(2 * limit * size - limit * limit) / size
            slope = limit / (size * value)
            for i in range(2 * c, 2 * c + 2):
                r[i] *= value
                for k in range(len(J)):
                    for j in range(6):
                        J[k, i, j] *= slope


def measurement_factor(
    measurement: Measurement, keys: list[tuple[int, int]], half: list[float], fixed: dict[int, Array]
) -> gtsam.CustomFactor:
    """A measured length as a factor of the poses of the tags' bodies and of the tags on them.

    Args:
        measurement: What was measured.
        keys: Of T_world_body and T_body_tag, for each point.
        half: Half of each point's tag's size [m].
        fixed: Poses (4, 4) that are no variables, by key.
    """
    points = zip(measurement.points, half, strict=True)
    corners = [np.zeros(3) if corner is None else SQUARE[corner] * h for (_, corner), h in points]
    free = list(dict.fromkeys(key for pair in keys for key in pair if key not in fixed))

    def pose(values: gtsam.Values, key: int) -> Array:
        return fixed[key] if key in fixed else np.asarray(values.atPose3(key).matrix())

    def error(_: Any, values: gtsam.Values, H: list[Array] | None) -> Array:
        places, slopes = [], []
        for (body, tag), x in zip(keys, corners, strict=True):
            T_world_body, T_body_tag = pose(values, body), pose(values, tag)
            R, y = T_world_body[:3, :3], T_body_tag[:3, :3] @ x + T_body_tag[:3, 3]
            places.append(R @ y + T_world_body[:3, 3])
            slopes.append(((body, R, y), (tag, R @ T_body_tag[:3, :3], x)))
        if measurement.direction is None:
            between = places[1] - places[0]
            length = float(np.linalg.norm(between))
            along = [-between / length, between / length]
        else:
            length = float(measurement.direction @ places[0])
            along = [measurement.direction]
        if H is not None:
            for i in range(len(free)):
                H[i] = np.zeros((1, 6))
            for direction, parts in zip(along, slopes, strict=True):
                for key, R, x in parts:
                    if key not in fixed:
                        row = direction @ R
                        H[free.index(key)] = H[free.index(key)] + np.concatenate([np.cross(x, row), row])[None]
        return np.array([length - measurement.length])

    noise = gtsam.noiseModel.Isotropic.Sigma(1, measurement.noise)
    return gtsam.CustomFactor(noise, free, error)
