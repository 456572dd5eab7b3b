"""SO(3), SE(3) and quaternions (wxyz, Hamilton), the only place where conventions are converted.

All functions take batches: the leading shape `*b` is free. `T_a_b` maps
coordinates in frame b to coordinates in frame a, X_a = T_a_b X_b. A rotation
perturbation is on the right (body frame): R(θ) = R exp(θ^).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]

_SMALL = 1e-8


def cross(a: Array, b: Array) -> Array:
    """Cross product a × b, several times as fast as `np.cross` on the small batches that are common here."""
    out = np.empty(np.broadcast_shapes(a.shape, b.shape))
    a0, a1, a2, b0, b1, b2 = a[..., 0], a[..., 1], a[..., 2], b[..., 0], b[..., 1], b[..., 2]
    out[..., 0] = a1 * b2 - a2 * b1
    out[..., 1] = a2 * b0 - a0 * b2
    out[..., 2] = a0 * b1 - a1 * b0
    return out


def quat_normalize(quat: ArrayLike) -> Array:
    """Unit quaternion with w >= 0 not enforced. (*b, 4) -> (*b, 4)."""
    quat = np.asarray(quat, dtype=float)
    return quat / np.linalg.norm(quat, axis=-1, keepdims=True)


def quat_mul(a: ArrayLike, b: ArrayLike) -> Array:
    """Hamilton product, R(a b) = R(a) R(b). (*b, 4), (*b, 4) -> (*b, 4)."""
    a, b = np.asarray(a, dtype=float), np.asarray(b, dtype=float)
    out = np.empty(np.broadcast_shapes(a.shape, b.shape))
    aw, ax, ay, az = (a[..., k] for k in range(4))
    bw, bx, by, bz = (b[..., k] for k in range(4))
    out[..., 0] = aw * bw - (ax * bx + ay * by + az * bz)
    out[..., 1] = aw * bx + bw * ax + (ay * bz - az * by)
    out[..., 2] = aw * by + bw * ay + (az * bx - ax * bz)
    out[..., 3] = aw * bz + bw * az + (ax * by - ay * bx)
    return out


def quat_conj(quat: ArrayLike) -> Array:
    """Conjugate: the inverse of a unit quaternion. (*b, 4) -> (*b, 4)."""
    return np.asarray(quat, dtype=float) * np.array([1.0, -1.0, -1.0, -1.0])


def quat_rotate(quat: ArrayLike, x: ArrayLike) -> Array:
    """R(quat) x. (*b, 4), (*b, 3) -> (*b, 3)."""
    quat, x = np.asarray(quat, dtype=float), np.asarray(x, dtype=float)
    w, u = quat[..., :1], quat[..., 1:]
    t = 2.0 * cross(u, x)
    return x + w * t + cross(u, t)


def quat_to_matrix(quat: ArrayLike) -> Array:
    """Rotation matrix of a unit quaternion. (*b, 4) -> (*b, 3, 3)."""
    w, x, y, z = np.moveaxis(np.asarray(quat, dtype=float), -1, 0)
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return np.stack([np.stack(r, axis=-1) for r in rows], axis=-2)


def matrix_to_quat(R: ArrayLike) -> Array:
    """Unit quaternion (w >= 0) of a rotation matrix, by the largest of its four squares.

    (*b, 3, 3) -> (*b, 4). Shepperd 1978.
    """
    R = np.asarray(R, dtype=float)
    m00, m11, m22 = R[..., 0, 0], R[..., 1, 1], R[..., 2, 2]
    squares = np.stack([1 + m00 + m11 + m22, 1 + m00 - m11 - m22, 1 - m00 + m11 - m22, 1 - m00 - m11 + m22], axis=-1)
    a, b, c = R[..., 2, 1] - R[..., 1, 2], R[..., 0, 2] - R[..., 2, 0], R[..., 1, 0] - R[..., 0, 1]
    d, e, f = R[..., 1, 0] + R[..., 0, 1], R[..., 0, 2] + R[..., 2, 0], R[..., 2, 1] + R[..., 1, 2]
    s0, s1, s2, s3 = np.moveaxis(squares, -1, 0)
    rows = np.stack(
        [
            np.stack([s0, a, b, c], axis=-1),
            np.stack([a, s1, d, e], axis=-1),
            np.stack([b, d, s2, f], axis=-1),
            np.stack([c, e, f, s3], axis=-1),
        ],
        axis=-2,
    )
    best = np.argmax(squares, axis=-1)[..., None, None]
    quat = quat_normalize(np.take_along_axis(rows, best, axis=-2)[..., 0, :])
    return np.where(quat[..., :1] < 0, -quat, quat)


def quat_exp(rotvec: ArrayLike) -> Array:
    """Quaternion of a rotation vector [rad]. (*b, 3) -> (*b, 4)."""
    rotvec = np.asarray(rotvec, dtype=float)
    angle = np.linalg.norm(rotvec, axis=-1, keepdims=True)
    # np.sinc(x) is sin(pi x) / (pi x): exact at zero
    return np.concatenate([np.cos(angle / 2), 0.5 * np.sinc(angle / (2 * np.pi)) * rotvec], axis=-1)


def quat_log(quat: ArrayLike) -> Array:
    """Rotation vector [rad] of the shorter way, norm in [0, pi]. (*b, 4) -> (*b, 3)."""
    quat = np.asarray(quat, dtype=float)
    w, x, y, z = (quat[..., k] for k in range(4))
    s = np.sqrt(x * x + y * y + z * z)
    angle = 2.0 * np.arctan2(s, np.abs(w))
    scale = np.where(s > _SMALL, angle / np.maximum(s, _SMALL), 2.0)
    return np.where(w < 0, -scale, scale)[..., None] * quat[..., 1:]


def quat_boxminus(a: ArrayLike, b: ArrayLike) -> Array:
    """log(b⁻¹ a): the body-frame rotation vector [rad] that takes b to a. (*b, 4) x2 -> (*b, 3)."""
    return quat_log(quat_mul(quat_conj(b), a))


def geodesic_angle(a: ArrayLike, b: ArrayLike) -> Array:
    """Angle [rad] in [0, pi] between two orientations. (*b, 4) x2 -> (*b,)."""
    return np.linalg.norm(quat_boxminus(a, b), axis=-1)


def quat_continuous(quat: ArrayLike) -> Array:
    """Flip signs along the first axis so that neighbours are near. (n, 4) -> (n, 4)."""
    quat = np.array(quat, dtype=float)
    if len(quat) > 1:
        steps = np.where(np.sum(quat[1:] * quat[:-1], axis=-1) < 0, -1.0, 1.0)
        quat[1:] *= np.cumprod(steps)[:, None]
    return quat


def skew(x: ArrayLike) -> Array:
    """x^ with x^ y = x × y. (*b, 3) -> (*b, 3, 3)."""
    x = np.asarray(x, dtype=float)
    out = np.zeros((*x.shape, 3))
    out[..., 0, 1], out[..., 0, 2], out[..., 1, 2] = -x[..., 2], x[..., 1], -x[..., 0]
    return out - np.swapaxes(out, -1, -2)


def rotvec_to_matrix(rotvec: ArrayLike) -> Array:
    """exp(θ^). (*b, 3) -> (*b, 3, 3)."""
    return quat_to_matrix(quat_exp(rotvec))


def matrix_to_rotvec(R: ArrayLike) -> Array:
    """log(R) [rad]. (*b, 3, 3) -> (*b, 3)."""
    return quat_log(matrix_to_quat(R))


def right_jacobian(rotvec: ArrayLike) -> Array:
    """J_r(θ) with exp((θ+δ)^) ≈ exp(θ^) exp((J_r δ)^). (*b, 3) -> (*b, 3, 3).

    Solà, Deray, Atchuthan, "A micro Lie theory for state estimation in robotics", eq. 143.
    """
    rotvec = np.asarray(rotvec, dtype=float)
    angle = np.linalg.norm(rotvec, axis=-1)[..., None, None]
    K = skew(rotvec)
    small = angle < 1e-4
    safe = np.where(small, 1.0, angle)
    a = np.where(small, 0.5 - angle**2 / 24, (1 - np.cos(safe)) / safe**2)
    b = np.where(small, 1 / 6 - angle**2 / 120, (safe - np.sin(safe)) / safe**3)
    return np.eye(3) - a * K + b * K @ K


def right_jacobian_inv(rotvec: ArrayLike) -> Array:
    """J_r(θ)⁻¹, for angles below 2 pi. (*b, 3) -> (*b, 3, 3). Solà et al., eq. 144."""
    return np.asarray(np.linalg.inv(right_jacobian(rotvec)))


def xyzw_to_wxyz(quat: ArrayLike) -> Array:
    """TUM, ROS and SciPy order to ours. (*b, 4) -> (*b, 4)."""
    return np.roll(np.asarray(quat, dtype=float), 1, axis=-1)


def wxyz_to_xyzw(quat: ArrayLike) -> Array:
    """Ours to TUM, ROS and SciPy order. (*b, 4) -> (*b, 4)."""
    return np.roll(np.asarray(quat, dtype=float), -1, axis=-1)


def transform(p: ArrayLike, quat: ArrayLike) -> Array:
    """Homogeneous T_a_b of a position [m] and a quaternion. (*b, 3), (*b, 4) -> (*b, 4, 4)."""
    R = quat_to_matrix(quat)
    T = np.zeros((*R.shape[:-2], 4, 4))
    T[..., :3, :3] = R
    T[..., :3, 3] = p
    T[..., 3, 3] = 1.0
    return T


def transform_from_rotvec(p: ArrayLike, rotvec: ArrayLike) -> Array:
    """Homogeneous T_a_b of a position [m] and a rotation vector [rad], as TagSLAM's YAML gives it."""
    return transform(p, quat_exp(rotvec))


def transform_inv(T: ArrayLike) -> Array:
    """T_b_a of T_a_b. (*b, 4, 4) -> (*b, 4, 4)."""
    T = np.asarray(T, dtype=float)
    out = np.zeros_like(T)
    Rt = np.swapaxes(T[..., :3, :3], -1, -2)
    out[..., :3, :3] = Rt
    out[..., :3, 3] = -np.squeeze(Rt @ T[..., :3, 3:], -1)
    out[..., 3, 3] = 1.0
    return out


def transform_points(T: ArrayLike, x: ArrayLike) -> Array:
    """T_a_b applied to points. (*b, 4, 4), (*b, n, 3) -> (*b, n, 3)."""
    T, x = np.asarray(T, dtype=float), np.asarray(x, dtype=float)
    return x @ np.swapaxes(T[..., :3, :3], -1, -2) + T[..., None, :3, 3]
