"""Velocities of bodies and corners, and the size of a velocity jump, over batches."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tossid.objects import JointType, ObjectModel, body_poses
from tossid.rotations import quat_rotate

Array = NDArray[np.float64]


def body_velocities(model: ObjectModel, q: Array, v: Array) -> tuple[Array, Array]:
    """Velocity of every body's frame.

    Args:
        q: (*b, nq). v: (*b, nv).

    Returns:
        velocity of the origins (*b, n_b, 3) [m/s, world] and angular velocities
        (*b, n_b, 3) [rad/s, world].
    """
    pos, quat = body_poses(model, q)
    linear = [v[..., :3]]
    angular = [quat_rotate(q[..., 3:7], v[..., 3:6])]
    for body in range(1, model.n_bodies):
        up = model.parent[body]
        axis = quat_rotate(quat[..., body, :], model.joint_axis[body])
        rate = v[..., 5 + body, None]
        if model.joint_type[body] == JointType.HINGE:
            spin = angular[up] + rate * axis
            lever = quat_rotate(quat[..., body, :], model.joint_pos[body])
            anchor = pos[..., body, :] + lever - pos[..., up, :]
            linear.append(linear[up] + np.cross(angular[up], anchor) - np.cross(spin, lever))
            angular.append(spin)
        else:
            reach = pos[..., body, :] - pos[..., up, :]
            linear.append(linear[up] + np.cross(angular[up], reach) + rate * axis)
            angular.append(angular[up])
    return np.stack(linear, axis=-2), np.stack(angular, axis=-2)


def corner_velocities(model: ObjectModel, q: Array, v: Array) -> Array:
    """World velocities [m/s] of the contact corners. (*b, nq), (*b, nv) -> (*b, n_c, 3)."""
    _, quat = body_poses(model, q)
    linear, angular = body_velocities(model, q, v)
    lever = quat_rotate(quat[..., model.corner_body, :], model.corner_pos)
    return linear[..., model.corner_body, :] + np.cross(angular[..., model.corner_body, :], lever)


def com_velocities(model: ObjectModel, q: Array, v: Array) -> Array:
    """World velocities [m/s] of the bodies' centres of mass. (*b, nq), (*b, nv) -> (*b, n_b, 3)."""
    _, quat = body_poses(model, q)
    linear, angular = body_velocities(model, q, v)
    return linear + np.cross(angular, quat_rotate(quat, model.com))


def jump_speed(model: ObjectModel, q: Array, before: Array, after: Array, free_fall: Array) -> Array:
    """Size of a change of velocity beyond free fall, as the speed of the whole mass with its kinetic energy.

    sqrt(Σ_i m_i |Δu_i|² + Δω_iᵀ I_i Δω_i) / sqrt(Σ m), with u the velocity of
    the bodies' centres of mass: the mass-metric norm of Δv, independent of
    where the base frame sits.

    Args:
        q: (*b, nq), where the jump happens. before, after: (*b, nv).
        free_fall: (*b,) g Δt, by which gravity alone slows the upward velocity [m/s].

    Returns:
        (*b,) [m/s].
    """
    _, quat = body_poses(model, q)
    step = after - before
    change = com_velocities(model, q, step)
    change[..., 2] += np.asarray(free_fall)[..., None]
    _, angular = body_velocities(model, q, step)
    spin = quat_rotate(quat * np.array([1.0, -1.0, -1.0, -1.0]), angular)
    energy = np.einsum("...bi,b,...bi->...", change, model.mass, change)
    energy += np.einsum("...bi,bij,...bj->...", spin, model.inertia, spin)
    return np.sqrt(energy / model.mass.sum())
