"""The pose graph's factors: what a camera saw of a body in one frame, and measured lengths (GTSAM, Numba)."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, NamedTuple

import gtsam
import numpy as np
from numpy.typing import NDArray

from tossid.kernels import kernel
from tossid.vision.setup.hinge import Hinge, Hinges
from tossid.vision.setup.layout import SQUARE, Coordinate, Distance

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


def view_factor(view: View, fixed: dict[int, Array], noise: Noise, *, huber: float) -> gtsam.CustomFactor:
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
        huber: Whitened residual of a corner beyond which the loss is linear.
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
    seen = _Tags(tag_slot, view.half, view.seen, view.whiten, edge_growth, huber * np.sqrt(view.count))
    joints, hinges = [key for key, _ in view.joints], Hinges.of([hinge for _, hinge in view.joints])
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
            here[2], by_joints = hinges.swing(here[2], [values.atDouble(key) for key in joints])
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


@kernel
def _apply(T: Array, x: Array, out: Array) -> None:
    for i in range(3):
        out[i] = T[i, 0] * x[0] + T[i, 1] * x[1] + T[i, 2] * x[2] + T[i, 3]


@kernel
def _apply_inv(T: Array, x: Array, out: Array) -> None:
    a, b, c = x[0] - T[0, 3], x[1] - T[1, 3], x[2] - T[2, 3]
    for i in range(3):
        out[i] = T[0, i] * a + T[1, i] * b + T[2, i] * c


@kernel
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


@kernel
def _turn(A: Array, T: Array, back: bool, out: Array) -> None:
    """A R, or A Rᵀ, of T's rotation. (2, 3)."""
    for i in range(2):
        for j in range(3):
            total = 0.0
            for k in range(3):
                total += A[i, k] * (T[j, k] if back else T[k, j])
            out[i, j] = total


@kernel
def _add_skewed(out: Array, A: Array, x: Array, sign: float) -> None:
    """out = sign · A · [-x^ | 1] for A (2, 3): the derivative by a tangent (rotation, translation). (2, 6)."""
    for i in range(2):
        out[i, 0] = sign * (A[i, 2] * x[1] - A[i, 1] * x[2])
        out[i, 1] = sign * (A[i, 0] * x[2] - A[i, 2] * x[0])
        out[i, 2] = sign * (A[i, 1] * x[0] - A[i, 0] * x[1])
        for j in range(3):
            out[i, 3 + j] = sign * A[i, j]


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
    """
    tag_slot, half, seen, whiten, edge_growth, limit = tags
    m, n = len(tag_slot), len(poses)
    r = np.zeros(8 * m)
    J = np.zeros((n + 1 + len(prints), 8 * m, 6))
    x, g, flat = np.empty(3), np.empty(8), np.zeros(3)
    y3, y3_late, y2, y1_step, y1, y0 = np.empty(3), np.empty(3), np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    T_rig_cam, T_world_rig, T_world_body = poses[0], poses[1], poses[2]
    E, F = _motion(body_twist, delay), _motion(rig_twist, delay)
    A0, A1, A2, A3, A4 = np.empty((2, 3)), np.empty((2, 3)), np.empty((2, 3)), np.empty((2, 3)), np.empty((2, 3))
    block = np.empty((2, 6))
    for d in range(m):
        T_body_tag = poses[3 + tag_slot[d]]
        p = prints[tag_slot[d]] if len(prints) else flat
        for c in range(4):
            sx, sy = SQUARE[c, 0] * half[d], SQUARE[c, 1] * half[d]
            x[0], x[1], x[2] = (1 + p[0]) * sx, (1 + p[1]) * sy, p[2] * SQUARE[c, 0] * sy
            _apply(T_body_tag, x, y3)
            _apply(E, y3, y3_late)
            _apply(T_world_body, y3_late, y2)
            _apply_inv(T_world_rig, y2, y1_step)
            _apply_inv(F, y1_step, y1)
            _apply_inv(T_rig_cam, y1, y0)
            row = 8 * d + 2 * c
            if y0[2] < 1e-6:  # behind the lens: a large constant error
                r[row] = 1e5
                g[2 * c], g[2 * c + 1] = 0.0, 0.0
                continue
            W = whiten[d, c] / scale
            iz = 1.0 / y0[2]
            u, v = y0[0] * iz, y0[1] * iz
            e0, e1 = u - seen[d, c, 0], v - seen[d, c, 1]
            for i in range(2):
                r[row + i] = W[i, 0] * e0 + W[i, 1] * e1
                g[2 * c + i] = scale * (W[i, 0] * edge_growth[d, c, 0] + W[i, 1] * edge_growth[d, c, 1])
                A0[i, 0], A0[i, 1] = W[i, 0] * iz, W[i, 1] * iz
                A0[i, 2] = -(W[i, 0] * u + W[i, 1] * v) * iz
            _turn(A0, T_rig_cam, True, A1)
            _turn(A1, F, True, A2)
            _turn(A2, T_world_rig, True, A3)
            _turn(A3, T_world_body, False, A4)
            _add_skewed(block, A0, y0, -1.0)
            J[0, row : row + 2] = block
            _add_skewed(block, A2, y1_step, -1.0)
            J[1, row : row + 2] += block
            _add_skewed(block, A4, y3_late, 1.0)
            J[2, row : row + 2] += block
            # by the delay: the body moves, and the rig under the cameras
            _add_skewed(block, A4, y3_late - delay * body_twist[3:], 1.0)
            for i in range(2):
                J[n, row + i, 0] = np.dot(block[i], body_twist)
            _add_skewed(block, A1, y1, -1.0)
            for i in range(2):
                J[n, row + i, 0] += np.dot(block[i, :3], rig_twist[:3]) - np.dot(A2[i], rig_twist[3:])
            _turn(A4, E, False, A3)
            _turn(A3, T_body_tag, False, A2)
            _add_skewed(block, A2, x, 1.0)
            J[3 + tag_slot[d], row : row + 2] = block
            if not len(prints):
                continue
            for i in range(2):
                J[n + 1 + tag_slot[d], row + i, 0] = A2[i, 0] * sx
                J[n + 1 + tag_slot[d], row + i, 1] = A2[i, 1] * sy
                J[n + 1 + tag_slot[d], row + i, 2] = A2[i, 2] * SQUARE[c, 0] * sy
        own = slice(8 * d, 8 * d + 8)
        if spread_sigma > 0:
            _whiten_spread(r[own], J[:, own], g, spread_sigma)
        _huber(r[own], J[:, own], limit[d])
    return r, J


@kernel
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


@kernel
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
    measurement: Distance | Coordinate, keys: list[tuple[int, int]], half: list[float], fixed: dict[int, Array]
) -> gtsam.CustomFactor:
    """A measured length as a factor of the poses of the tags' bodies and of the tags on them.

    Args:
        measurement: What was measured.
        keys: Of T_world_body and T_body_tag, for each tag.
        half: Half of each tag's size [m].
        fixed: Poses (4, 4) that are no variables, by key.
    """
    if isinstance(measurement, Distance):
        corners = [SQUARE[c] * h for c, h in zip(measurement.corners, half, strict=True)]
    else:
        corners = [np.zeros(3) if measurement.corner is None else SQUARE[measurement.corner] * half[0]]
    free = list(dict.fromkeys(key for pair in keys for key in pair if key not in fixed))

    def pose(values: gtsam.Values, key: int) -> Array:
        return fixed[key] if key in fixed else np.asarray(values.atPose3(key).matrix())

    def error(_: Any, values: gtsam.Values, H: list[Array] | None) -> Array:
        places, slopes = [], []
        for (body, tag), x in zip(keys, corners, strict=True):
            T_world_body, T_body_tag = pose(values, body), pose(values, tag)
            y = T_body_tag[:3, :3] @ x + T_body_tag[:3, 3]
            places.append(T_world_body[:3, :3] @ y + T_world_body[:3, 3])
            R = T_world_body[:3, :3]
            slopes.append(((body, R, y), (tag, R @ T_body_tag[:3, :3], x)))
        if isinstance(measurement, Distance):
            way = places[1] - places[0]
            length = float(np.linalg.norm(way))
            along = [-way / length, way / length]
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
