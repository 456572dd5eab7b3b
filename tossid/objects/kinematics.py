"""Forward kinematics of an object's tree, over batches (NumPy; physics has its own kernels)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tossid.objects.model import JointType, ObjectModel
from tossid.rotations import quat_conj, quat_exp, quat_mul, quat_rotate

Array = NDArray[np.float64]


def body_poses(model: ObjectModel, q: Array) -> tuple[Array, Array]:
    """World pose of every body's frame.

    Args:
        model: The object.
        q: (*b, nq) configurations.

    Returns:
        positions (*b, n_b, 3) [m] and quaternions (*b, n_b, 4).
    """
    q = np.asarray(q, dtype=float)
    pos = [q[..., :3]]
    quat = [q[..., 3:7]]
    for body in range(1, model.n_bodies):
        up = model.parent[body]
        angle = q[..., 6 + body, None]
        quat_0 = quat_mul(quat[up], model.body_quat[body])
        pos_0 = pos[up] + quat_rotate(quat[up], model.body_pos[body])
        if model.joint_type[body] == JointType.HINGE:
            turned = quat_mul(quat_0, quat_exp(angle * model.joint_axis[body]))
            anchor = pos_0 + quat_rotate(quat_0, model.joint_pos[body])
            pos.append(anchor - quat_rotate(turned, model.joint_pos[body]))
            quat.append(turned)
        else:
            pos.append(pos_0 + quat_rotate(quat_0, angle * model.joint_axis[body]))
            quat.append(quat_0)
    return np.stack(pos, axis=-2), np.stack(quat, axis=-2)


def corner_positions(model: ObjectModel, q: Array) -> Array:
    """World positions [m] of the contact corners; of round ones, of their lowest points. (*b, nq) -> (*b, n_c, 3)."""
    pos, quat = body_poses(model, q)
    turn = quat[..., model.corner_body, :]
    return pos[..., model.corner_body, :] + quat_rotate(turn, lowest_points(model, turn))


def corner_heights(model: ObjectModel, q: Array) -> Array:
    """Heights [m] of the contact corners; of round ones, of their lowest points. (*b, nq) -> (*b, n_c)."""
    if model.n_joints or model.roundness is not None:
        return corner_positions(model, q)[..., 2]
    w, x, y, z = np.moveaxis(np.asarray(q, dtype=float)[..., 3:7], -1, 0)
    up = np.stack([2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)], axis=-1)  # in the body's frame
    return np.asarray(q[..., 2, None] + up @ model.corner_pos.T)


def lowest_points(model: ObjectModel, turn: Array) -> Array:
    """The corners or, of round ones, their lowest points, in their bodies' frames [m].

    Args:
        model: The object.
        turn: (*b, n_c, 4) orientation of each corner's body.

    Returns:
        (*b, n_c, 3), or (n_c, 3) where no corner is round.
    """
    if model.roundness is None:
        return model.corner_pos
    down = quat_rotate(quat_conj(turn), np.array([0.0, 0.0, -1.0]))
    return np.asarray(model.corner_pos + model.roundness.offset(down))


def center_positions(model: ObjectModel, q: Array) -> Array:
    """World position [m] of the geometric centre. (*b, nq) -> (*b, 3)."""
    return q[..., :3] + quat_rotate(q[..., 3:7], model.center)
