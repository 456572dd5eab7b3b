"""What pulls at an object in the air: of a world's gravity and forces, and of a learned acceleration."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tossid.objects import ObjectModel, corner_heights
from tossid.physics.batch import learned_accelerations, tree_batch
from tossid.physics.effects.in_mujoco import body_motions, wrench_of_world
from tossid.physics.effects.world import World
from tossid.physics.system import LearnedAcceleration, make_system
from tossid.rotations import quat_conj, quat_rotate

Array = NDArray[np.float64]


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
    """The same from the motions of an object's bodies, which need not be computed anew for other forces.

    Args:
        world: the simulator.
        q: (B, nq) true configurations.
        motions: what `body_motions` gives.

    Returns:
        As of `acceleration_of_forces`.
    """
    model, wrench, total = world.object, wrench_of_world(world), float(world.object.mass.sum())
    p, u, omega = motions
    linear = np.tile(world.gravity_on_ground(), (len(q), 1))
    for b in range(model.n_bodies):
        force, torque = wrench(p[:, b], u[:, b], omega[:, b])
        linear += model.mass[b] / total * force / total
    if model.n_joints:
        return linear
    angular = quat_rotate(quat_conj(q[:, 3:7]), torque) @ np.linalg.inv(model.inertia[0]).T
    return np.concatenate([linear, angular], axis=1)


def learned_field(model: ObjectModel, k_res: LearnedAcceleration | None, q: Array, v: Array) -> Array:
    """What a learned acceleration does to an object in the air.

    Args:
        model: the object, as it was learned.
        k_res: the learned acceleration; None for none.
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
    """Marks states (B,) in which all corners are clear of the ground; a field may make flights unlike free fall.

    Args:
        model: the object.
        q: (B, nq) configurations in the ground's frame.
        clearance: share of the width above the ground.
    """
    return np.asarray(corner_heights(model, q).min(axis=-1) > clearance * model.width)


def share_recovered(found: Array, true: Array) -> float:
    """1 - |found - true| / |true|, root mean squares over states: 1 for the field itself, 0 for none.

    Args:
        found: (B, 3) accelerations that were learned.
        true: (B, 3) those that act.
    """
    size, miss = (float(np.sqrt(np.square(x).sum(axis=1).mean())) for x in (true, found - true))
    return 1.0 - miss / size
