"""What acts on an object in the air: wrenches and accelerations of a world's forces, and of a learned acceleration."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from tossid.objects import ObjectModel, corner_heights
from tossid.physics.batch import tree_batch
from tossid.physics.effects.world import World
from tossid.physics.forces import wrench
from tossid.physics.network import LearnedAcceleration, learned_accelerations
from tossid.physics.registered_forces import combined, wrenches_of
from tossid.physics.system import make_system
from tossid.rotations import quat_conj, quat_rotate

Array = NDArray[np.float64]


def wrench_of_world(world: World) -> Callable[[Array, Array, Array], tuple[Array, Array]]:
    """The forces of a world's state on a single body of the object's whole mass, gravity not among them.

    Args:
        world: the simulator.

    Returns:
        A function from the place and velocity of the body's centre of mass and its spin, (B, 3) each, to the force [N]
        there and the torque [N m], (B, 3) each; all in the ground's axes.
    """
    forces, mass, registered = world.forces_on_ground(), float(world.object.mass.sum()), combined(world.registered)

    def acting(p: Array, u: Array, omega: Array) -> tuple[Array, Array]:
        force, torque = wrench(forces, mass, p, u, omega)
        if world.registered:
            more, turning = wrenches_of(registered, p, u, omega)
            return force + more, torque + turning
        return force, torque

    return acting


def body_motions(model: ObjectModel, q: Array, v: Array) -> tuple[Array, Array, Array]:
    """Motion of the bodies, in world axes.

    Args:
        model: the object.
        q: (B, nq) configurations.
        v: (B, nv) velocities.

    Returns:
        Positions [m] and velocities [m/s] of the bodies' centres of mass, and spins [rad/s], (B, n_b, 3) each.
    """
    turned = tree_batch(make_system(model), q, v)
    spin = np.einsum("nbij,nbj->nbi", turned.R, turned.omega)
    arm = np.einsum("nbij,bj->nbi", turned.R, model.com)
    origin = np.einsum("nbij,nbjk,nk->nbi", turned.R, turned.X[:, :, 3:], v)
    return turned.x + arm, origin + np.cross(spin, arm), spin


def acceleration_of_forces(world: World, q: Array, v: Array) -> Array:
    """What gravity and the forces of a world's state do to an object in the air, in the ground's frame.

    Args:
        world: the simulator; its learned acceleration is not among the forces.
        q: (B, nq) true configurations.
        v: (B, nv) velocities.

    Returns:
        (B, 6): acceleration of the common centre of mass along the world's axes [m/s²], and angular acceleration by
        torques in the body's axes [rad/s²]; (B, 3), the first alone, for an object with joints.
    """
    return acceleration_of_motions(world, q, body_motions(world.object, q, v))


def acceleration_of_motions(world: World, q: Array, motions: tuple[Array, Array, Array]) -> Array:
    """The same from `body_motions` of the object, which need not be computed anew for other forces."""
    model, acting, total = world.object, wrench_of_world(world), float(world.object.mass.sum())
    p, u, omega = motions
    linear = np.tile(world.gravity_on_ground(), (len(q), 1))
    for b in range(model.n_bodies):
        force, torque = acting(p[:, b], u[:, b], omega[:, b])
        linear += model.mass[b] / total * force / total
    if model.n_joints:
        return linear
    angular = quat_rotate(quat_conj(q[:, 3:7]), torque) @ np.linalg.inv(model.inertia[0]).T
    return np.concatenate([linear, angular], axis=1)


def learned_field(model: ObjectModel, k_res: LearnedAcceleration | None, q: Array, v: Array) -> Array:
    """What a learned acceleration (None for none) does to an object in the air.

    Args:
        model: the object, as it was learned.
        k_res: the learned acceleration.
        q: (B, nq) true configurations.
        v: (B, nv) velocities.

    Returns:
        (B, 6) or (B, 3), as of `acceleration_of_forces`.
    """
    if k_res is None:
        return np.zeros((len(q), 3 if model.n_joints else 6))
    batch = tree_batch(make_system(model), q, v)
    a_res = learned_accelerations(k_res, batch.features, model.nv)
    a_res[:, :3] = np.einsum("nij,nj->ni", batch.R[:, 0], a_res[:, :3])
    # accelerations go the way that velocities do, in a given posture
    _, bodies, _ = body_motions(model, q, a_res)
    linear = np.einsum("b,nbi->ni", model.mass / model.mass.sum(), bodies)
    return linear if model.n_joints else np.concatenate([linear, a_res[:, 3:6]], axis=1)


def airborne(model: ObjectModel, q: Array, *, clearance: float = 0.1) -> NDArray[np.bool_]:
    """Marks states (B,), of configurations q (B, nq) in the ground's frame, in which all corners are off the ground.

    They are clear of it by a share of the width. (A field may make flights unlike free fall.)
    """
    return np.asarray(corner_heights(model, q).min(axis=-1) > clearance * model.width)
