"""The pose graph's factors: what a camera saw of a body in one time step, and measured lengths (GTSAM, Numba)."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import gtsam
import numpy as np
from numba import njit
from numpy.typing import NDArray

from tossid.vision.hinge import Hinge, Hinges
from tossid.vision.layout import Coordinate, Distance
from tossid.vision.resect import HUBER, SQUARE

Array = NDArray[np.float64]
Ints = NDArray[np.int64]


@dataclass(eq=False)
class Noise:
    """Standard deviation of corners over what they promise, shared by all factors, set between optimisations.

    swell: by how much a tag's edges spread [px, standard deviation], over the same.
    """

    scale: float = 1.0
    swell: float = 0.0


@dataclass(frozen=True, slots=True)
class Flaws:
    """How tags may differ from flat squares with sharp edges.

    swell: by how much a tag's edges spread in an image, from one image to the next [px, standard deviation], over the
    noise's scale. printed: tags whose print is to be found.
    """

    swell: float = 0.0
    printed: frozenset[int] = frozenset()


NO_FLAWS = Flaws()


@dataclass(frozen=True, eq=False)
class View:
    """What one camera saw of one body in one frame.

    camera, rig, body: keys of T_rig_cam, T_world_rig, T_world_body. tags: (m,) key of each sighting's T_body_tag.
    half: (m,) [m]. seen: (m, 4, 2), whiten: (m, 4, 2, 2), count: (m,) as in `Scene`. late: how much later than
    the step's poses the frame is [s]. rig_twist, body_twist: (6,) motion during it (rotation [rad/s], translation
    [m/s], in the moving frame). clock: key of the camera's clock offset [s], None if that is known. joints: of a
    body that hangs on another one, whose key then is `body`: keys of the angles, and the hinges, outwards.
    grow: (m, 4, 2) as in `Scene`, None for none. prints: by the key of a tag's pose, its print as `State.prints` has
    it, and the key of that where it is a variable.
    """

    camera: int
    rig: int
    body: int
    tags: tuple[int, ...]
    half: Array
    seen: Array
    whiten: Array
    count: Array
    late: float
    rig_twist: Array
    body_twist: Array
    clock: int | None = None
    joints: tuple[tuple[int, Hinge], ...] = ()
    grow: Array | None = None
    prints: dict[int, tuple[Array, int | None]] = field(default_factory=dict)


def view_factor(view: View, fixed: dict[int, Array], noise: Noise) -> gtsam.CustomFactor:
    """Whitened reprojection errors of a view's corners as a factor of every pose on the way that is not fixed.

    x_cam = T_rig_cam⁻¹ · (T_world_rig M_rig(δ))⁻¹ · T_world_body M_body(δ) · T_body_tag · x_tag, where M(δ) is
    the motion from the step to the frame's own time δ after it, and T_world_body = T_world_root · T(θ₁) · … of a body
    that hangs on others. Huber's loss is in the residual itself,
    r √(2ρ(|r|))/|r|: GTSAM's error is then the robust one, and its gradient the exact one. Corners of a tag whose
    edges spread by b ~ N(0, σ²) have the covariance I + σ² g gᵀ (g: how they move by b, whitened), whose inverse root
    whitens them.

    Args:
        fixed: key: (4, 4) of poses that are no variables.
    """
    tags = list(dict.fromkeys(view.tags))
    chain = [view.camera, view.rig, view.body, *tags]
    slot_of = {key: slot for slot, key in enumerate(chain)}
    tag_slot = np.array([tags.index(key) for key in view.tags], dtype=np.int64)
    free = list(dict.fromkeys(key for key in chain if key not in fixed))
    slots = [slot_of[key] for key in free]
    poses = np.stack([fixed.get(key, np.eye(4)) for key in chain])
    rows = 8 * len(view.tags)
    grow = np.zeros_like(view.seen) if view.grow is None else view.grow
    limit = HUBER * np.sqrt(view.count)
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
        swung = np.zeros((0, 0))
        if joints:
            here[2], swung = hinges.swing(here[2], [values.atDouble(key) for key in joints])
        prints = as_given.copy()
        for slot, key in printed:
            prints[slot] = values.atPoint3(key)
        late = view.late - (values.atDouble(view.clock) if view.clock is not None else 0.0)
        r, J = _reproject(
            here, tag_slot, prints, view.half, view.seen, view.whiten, grow,
            late, view.rig_twist, view.body_twist, noise.scale, noise.swell, limit,
        )  # fmt: skip
        if H is not None:
            if joints:
                by = J[2] @ swung
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


@njit(cache=True)
def _apply(T: Array, x: Array, out: Array) -> None:
    for i in range(3):
        out[i] = T[i, 0] * x[0] + T[i, 1] * x[1] + T[i, 2] * x[2] + T[i, 3]


@njit(cache=True)
def _apply_inv(T: Array, x: Array, out: Array) -> None:
    a, b, c = x[0] - T[0, 3], x[1] - T[1, 3], x[2] - T[2, 3]
    for i in range(3):
        out[i] = T[0, i] * a + T[1, i] * b + T[2, i] * c


@njit(cache=True)
def _moved(twist: Array, late: float) -> Array:
    """The motion (exp(ω δ), v δ) within a frame, as `resect.retract` has it."""
    T = np.eye(4)
    w = twist[:3] * late
    angle2 = w[0] * w[0] + w[1] * w[1] + w[2] * w[2]
    angle = np.sqrt(angle2)
    a = np.sin(angle) / angle if angle > 1e-8 else 1.0
    b = (1 - np.cos(angle)) / angle2 if angle > 1e-8 else 0.5
    K = np.array([[0.0, -w[2], w[1]], [w[2], 0.0, -w[0]], [-w[1], w[0], 0.0]])
    T[:3, :3] += a * K + b * (K @ K)
    for i in range(3):
        T[i, 3] = twist[3 + i] * late
    return T


@njit(cache=True)
def _turn(A: Array, T: Array, back: bool, out: Array) -> None:
    """A R, or A Rᵀ, of T's rotation. (2, 3)."""
    for i in range(2):
        for j in range(3):
            total = 0.0
            for k in range(3):
                total += A[i, k] * (T[j, k] if back else T[k, j])
            out[i, j] = total


@njit(cache=True)
def _add_skewed(out: Array, A: Array, x: Array, sign: float) -> None:
    """out = sign · A · [-x^ | 1] for A (2, 3): the derivative by a tangent (rotation, translation). (2, 6)."""
    for i in range(2):
        out[i, 0] = sign * (A[i, 2] * x[1] - A[i, 1] * x[2])
        out[i, 1] = sign * (A[i, 0] * x[2] - A[i, 2] * x[0])
        out[i, 2] = sign * (A[i, 1] * x[0] - A[i, 0] * x[1])
        for j in range(3):
            out[i, 3 + j] = sign * A[i, j]


@njit(cache=True)
def _reproject(
    poses: Array,
    tag_slot: Ints,
    prints: Array,
    half: Array,
    seen: Array,
    whiten: Array,
    grow: Array,
    late: float,
    rig_twist: Array,
    body_twist: Array,
    scale: float,
    swell: float,
    limit: Array,
) -> tuple[Array, Array]:
    """Robust whitened residuals (8 m,), and their derivatives by each pose of the chain, by the frame's lateness and,
    last, by the print of each tag of the chain (chain + 1 + tags, 8 m, 6)."""
    m, n = len(tag_slot), len(poses)
    r = np.zeros(8 * m)
    J = np.zeros((n + 1 + len(prints), 8 * m, 6))
    x, g, flat = np.empty(3), np.empty(8), np.zeros(3)
    y3, y3_late, y2, y1_step, y1, y0 = np.empty(3), np.empty(3), np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    T_rig_cam, T_world_rig, T_world_body = poses[0], poses[1], poses[2]
    E, F = _moved(body_twist, late), _moved(rig_twist, late)
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
            if y0[2] < 1e-6:  # behind the lens: far off, and nowhere to go
                r[row] = 1e5
                g[2 * c], g[2 * c + 1] = 0.0, 0.0
                continue
            W = whiten[d, c] / scale
            iz = 1.0 / y0[2]
            u, v = y0[0] * iz, y0[1] * iz
            e0, e1 = u - seen[d, c, 0], v - seen[d, c, 1]
            for i in range(2):
                r[row + i] = W[i, 0] * e0 + W[i, 1] * e1
                g[2 * c + i] = scale * (W[i, 0] * grow[d, c, 0] + W[i, 1] * grow[d, c, 1])
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
            # by the time: the body moves on, and the rig under the cameras
            _add_skewed(block, A4, y3_late - late * body_twist[3:], 1.0)
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
        if swell > 0:
            _take_off(r[own], J[:, own], g, swell)
        _huber(r[own], J[:, own], limit[d])
    return r, J


@njit(cache=True)
def _take_off(r: Array, J: Array, g: Array, swell: float) -> None:
    """Residuals (8,) and derivatives (n, 8, 6) times the inverse root of I + σ² g gᵀ."""
    square = np.dot(g, g)
    share = (1 - 1 / np.sqrt(1 + swell * swell * square)) / max(square, 1e-300)
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


@njit(cache=True)
def _huber(r: Array, J: Array, limit: float) -> None:
    """Huber's loss in each corner's residual, of (8,), and its derivatives (n, 8, 6)."""
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
        keys: (T_world_body, T_body_tag) of each tag. half: half the size of each [m]. fixed: as in `view_factor`.
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
