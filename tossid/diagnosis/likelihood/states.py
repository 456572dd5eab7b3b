"""Differences of states, in the channels of windows: the base's position and rotation, and each joint."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tossid.rotations import quat_boxminus, quat_exp, quat_mul, quat_normalize

Array = NDArray[np.float64]


def difference(measured: Array, predicted: Array) -> Array:
    """(..., K) measured poses minus predicted ones, rotations as vectors in the predicted body frame.

    Args:
        measured: (..., K + 1) poses.
        predicted: (..., K + 1) poses.
    """
    turned = quat_boxminus(measured[..., 3:7], predicted[..., 3:7])
    joints = measured[..., 7:] - predicted[..., 7:]
    return np.concatenate([measured[..., :3] - predicted[..., :3], turned, joints], axis=-1)


def moved_pose(q: Array, by: Array) -> Array:
    """(..., K + 1) poses that differ from `q` by `by`: the inverse of `difference`.

    Args:
        q: (..., K + 1) poses.
        by: (..., K) positions, rotation vectors in the body frame, joints.
    """
    turned = quat_normalize(quat_mul(q[..., 3:7], quat_exp(by[..., 3:6])))
    return np.concatenate([q[..., :3] + by[..., :3], turned, q[..., 7:] + by[..., 6:]], axis=-1)


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
