"""Centres of mass, velocities of bodies and corners, and the size of a velocity jump, over batches."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tossid.objects import JointType, ObjectModel, body_poses, lowest_points
from tossid.rotations import cross, quat_conj, quat_rotate

Array = NDArray[np.float64]


def center_of_mass(model: ObjectModel, q: Array) -> Array:
    """World position of the whole object's centre of mass [m], (*b, 3).

    Args:
        model: The object.
        q: Configurations, (*b, nq).
    """
    position, quat = body_poses(model, q)
    com = position + quat_rotate(quat, model.com)
    return np.asarray(np.einsum("b,...bi->...i", model.mass, com) / model.mass.sum())


def gyration(model: ObjectModel) -> float:
    """Radius of gyration of the base about its centre of mass, which compares spins with speeds [m].

    Args:
        model: The object.
    """
    return float(np.sqrt(np.trace(model.inertia[0]) / 3 / model.mass[0]))


def body_motions(model: ObjectModel, q: Array, v: Array) -> tuple[Array, Array, Array]:
    """Orientations and velocities of every body's frame.

    Args:
        model: The object.
        q: Configurations, (*b, nq).
        v: Velocities, (*b, nv).

    Returns:
        Quaternions (*b, n_b, 4), velocities of the origins (*b, n_b, 3) [m/s, world] and angular velocities
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
            linear.append(linear[up] + cross(angular[up], anchor) - cross(spin, lever))
            angular.append(spin)
        else:
            reach = pos[..., body, :] - pos[..., up, :]
            linear.append(linear[up] + cross(angular[up], reach) + rate * axis)
            angular.append(angular[up])
    return quat, np.stack(linear, axis=-2), np.stack(angular, axis=-2)


def corner_velocities(model: ObjectModel, q: Array, v: Array) -> Array:
    """World velocities of the contact corners [m/s], (*b, n_c, 3).

    Args:
        model: The object.
        q: Configurations, (*b, nq).
        v: Velocities, (*b, nv).
    """
    quat, linear, angular = (part[..., model.corner_body, :] for part in body_motions(model, q, v))
    return linear + cross(angular, quat_rotate(quat, lowest_points(model, quat)))


def com_velocities(model: ObjectModel, q: Array, v: Array) -> Array:
    """World velocities of the bodies' centres of mass [m/s], (*b, n_b, 3).

    Args:
        model: The object.
        q: Configurations, (*b, nq).
        v: Velocities, (*b, nv).
    """
    quat, linear, angular = body_motions(model, q, v)
    return linear + cross(angular, quat_rotate(quat, model.com))


def jump_speed(model: ObjectModel, q: Array, before: Array, after: Array, free_fall: Array) -> Array:
    """Size of a change of velocity beyond free fall, as a speed of the whole mass with the same kinetic energy, (*b,).

    sqrt(Σ_i m_i |Δu_i|² + Δω_iᵀ I_i Δω_i) / sqrt(Σ m), u being the velocity of the bodies' centres of mass: the norm of
    Δv in the metric of the mass matrix, which does not depend on where the base frame is. [m/s].

    Args:
        model: The object.
        q: Where the velocity changes, (*b, nq).
        before: Velocity, (*b, nv).
        after: Velocity, (*b, nv).
        free_fall: g Δt, by which gravity alone reduces the upward velocity [m/s], (*b,).
    """
    quat, linear, angular = body_motions(model, q, after - before)
    change = linear + cross(angular, quat_rotate(quat, model.com))
    change[..., 2] += np.asarray(free_fall)[..., None]
    spin = quat_rotate(quat_conj(quat), angular)
    energy = np.einsum("...bi,b,...bi->...", change, model.mass, change)
    energy += np.einsum("...bi,bij,...bj->...", spin, model.inertia, spin)
    return np.sqrt(energy / model.mass.sum())
