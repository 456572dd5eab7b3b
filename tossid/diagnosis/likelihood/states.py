"""Differences of states, in the channels of windows: the base's position and rotation, and each joint."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from tossid.kernels import inlined_kernel, kernel

Array = NDArray[np.float64]

_SMALL = 1e-8
"""Sine of half an angle below which the angle is twice that."""


def difference(measured: Array, predicted: Array) -> Array:
    """(..., K) measured poses minus predicted ones, rotations as vectors in the predicted body frame.

    Args:
        measured: (..., K + 1) poses.
        predicted: (..., K + 1) poses.
    """
    if measured.shape != predicted.shape:
        measured, predicted = np.broadcast_arrays(measured, predicted)
    out = np.empty((*measured.shape[:-1], measured.shape[-1] - 1))
    _differences(_rows(measured), _rows(predicted), _rows(out))
    return out


def moved_pose(q: Array, by: Array) -> Array:
    """(..., K + 1) poses that differ from `q` by `by`: the inverse of `difference`.

    Args:
        q: (..., K + 1) poses.
        by: (..., K) positions, rotation vectors in the body frame, joints.
    """
    if q.shape[:-1] != by.shape[:-1]:
        shape = np.broadcast_shapes(q.shape[:-1], by.shape[:-1])
        q, by = np.broadcast_to(q, (*shape, q.shape[-1])), np.broadcast_to(by, (*shape, by.shape[-1]))
    out = np.empty(q.shape)
    _moved(_rows(q), _rows(by), _rows(out))
    return out


def _rows(values: Array) -> Array:
    """(N, k) of an array (..., k), contiguous; a view where it is so already."""
    return np.ascontiguousarray(values, dtype=float).reshape(-1, values.shape[-1])


@inlined_kernel
def pose_difference(y, p, out):  # type: ignore[no-untyped-def]
    """Write y minus p (K + 1,) into out (K,), the rotation as log(p^-1 y): `tossid.rotations.quat_boxminus`."""
    for k in range(3):
        out[k] = y[k] - p[k]
    aw, ax, ay, az = p[3], -p[4], -p[5], -p[6]
    bw, bx, by, bz = y[3], y[4], y[5], y[6]
    w = aw * bw - (ax * bx + ay * by + az * bz)
    x = aw * bx + bw * ax + (ay * bz - az * by)
    y_ = aw * by + bw * ay + (az * bx - ax * bz)
    z = aw * bz + bw * az + (ax * by - ay * bx)
    s = math.sqrt(x * x + y_ * y_ + z * z)
    angle = 2.0 * math.atan2(s, abs(w))
    scale = angle / s if s > _SMALL else 2.0
    if w < 0.0:
        scale = -scale
    out[3], out[4], out[5] = scale * x, scale * y_, scale * z
    for k in range(6, out.shape[0]):
        out[k] = y[k + 1] - p[k + 1]


@kernel(allocates=False)
def _differences(measured, predicted, out):  # type: ignore[no-untyped-def]
    for i in range(len(out)):
        pose_difference(measured[i], predicted[i], out[i])


@kernel(allocates=False)
def _moved(q, by, out):  # type: ignore[no-untyped-def]
    """Write poses q (N, K + 1), moved by vectors (N, K), into `out`; rotations as q exp(by)."""
    for i in range(len(out)):
        for k in range(3):
            out[i, k] = q[i, k] + by[i, k]
        x, y, z = by[i, 3], by[i, 4], by[i, 5]
        half = 0.5 * math.sqrt(x * x + y * y + z * z)
        w, scale = math.cos(half), 0.5 * math.sin(half) / half if half > 0.0 else 0.5
        x, y, z = scale * x, scale * y, scale * z
        qw, qx, qy, qz = q[i, 3], q[i, 4], q[i, 5], q[i, 6]
        w, x, y, z = (
            qw * w - (qx * x + qy * y + qz * z),
            qw * x + w * qx + (qy * z - qz * y),
            qw * y + w * qy + (qz * x - qx * z),
            qw * z + w * qz + (qx * y - qy * x),
        )
        norm = math.sqrt(w * w + x * x + y * y + z * z)
        out[i, 3], out[i, 4], out[i, 5], out[i, 6] = w / norm, x / norm, y / norm, z / norm
        for k in range(7, out.shape[1]):
            out[i, k] = q[i, k] + by[i, k - 1]


def moved_state(q: Array, v: Array, delta: Array) -> tuple[Array, Array]:
    """Poses (W, nq) and velocities (W, K) that differ from others by vectors (W, 2 K).

    Args:
        q: (W, nq) poses.
        v: (W, K) velocities.
        delta: (W, 2 K) as `moved_pose` has it, then differences of velocities.
    """
    K = v.shape[1]
    return moved_pose(q, delta[:, :K]), v + delta[:, K:]


def of_state(sizes: tuple[float, float, float, float], K: int) -> Array:
    """(2 K,) a number for each part of a state.

    Args:
        sizes: For positions, rotations and joints, velocities, and angular velocities and joint rates.
        K: Number of channels.
    """
    position, rotation, velocity, spin = sizes
    return np.array([position] * 3 + [rotation] * (K - 3) + [velocity] * 3 + [spin] * (K - 3))
