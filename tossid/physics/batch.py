"""The parts of a tree's dynamics that depend on the motion alone, for batches of states, and what follows from them.

With these, M, bias and contact Jacobians are linear in the inertial parameters (mass, first moment, moments about the
body's origin) and in the corners' positions, so that a model can learn both by automatic differentiation without
differentiating through kinematics. Plain NumPy but for the recursion along the tree; the time stepper's kernels
(`articulated`, `body`) are others, and tests hold them to this.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tossid.physics.articulated import (
    ACCEL,
    ALPHA,
    ANCHOR,
    AXIS,
    HINGE,
    SPIN,
    WIDTH,
    X,
    make_articulated,
    outward_passes,
)
from tossid.physics.network import features, learned_accelerations
from tossid.physics.system import System
from tossid.rotations import quat_to_matrix, skew

Array = NDArray[np.float64]


class TreeBatch(NamedTuple):
    """Kinematic quantities of B states.

    Attributes:
        X: (B, n_b, 6, nv) each body's Jacobian in its own axes: angular rows, then linear rows of its frame's origin.
        omega: (B, n_b, 3) angular velocity, body axes [rad/s].
        alpha: (B, n_b, 3) angular acceleration at dv/dt = 0, body axes [rad/s²].
        xdd: (B, n_b, 3) the origin's acceleration at dv/dt = 0, body axes [m/s²].
        R: (B, n_b, 3, 3) world rotation of the bodies.
        x: (B, n_b, 3) world position of their origins [m].
        features: (B, n_f) the learned acceleration's input, with the features of the world.
    """

    X: Array
    omega: Array
    alpha: Array
    xdd: Array
    R: Array
    x: Array
    features: Array


def tree_batch(system: System, q: Array, v: Array) -> TreeBatch:
    """Kinematic quantities of states; inertia and contact do not enter.

    Args:
        system: The simulator's parameters.
        q: (B, nq) configurations.
        v: (B, nv) velocities.
    """
    q, v = np.ascontiguousarray(q, dtype=float), np.ascontiguousarray(v, dtype=float)
    count, nb = len(q), len(system.parent)
    P, E = np.zeros((count, nb, WIDTH)), np.zeros((count, nb, 3, 3))
    outward_passes(make_articulated(system), q, v, P, E)
    R, back = quat_to_matrix(q[:, 3:7]), np.swapaxes(E, -1, -2)

    def vectors(first: int) -> Array:
        return P[..., first : first + 3]

    # columns of the Jacobians in the base's axes: velocity of the base's origin, spin of the base, rates of the joints
    angular, linear = np.zeros((2, count, nb, 3, system.nv))
    angular[..., 3:6] = np.eye(3)
    linear[..., :3] = np.swapaxes(R, -1, -2)[:, None]
    linear[..., 3:6] = -skew(vectors(X))
    for body in range(nb):
        joint = body
        while joint > 0:
            axis = vectors(AXIS)[:, joint]
            if system.joint_type[joint] == HINGE:
                angular[:, body, :, 5 + joint] = axis
                linear[:, body, :, 5 + joint] = np.cross(axis, vectors(X)[:, body] - vectors(ANCHOR)[:, joint])
            else:
                linear[:, body, :, 5 + joint] = axis
            joint = int(system.parent[joint])
    return TreeBatch(
        X=np.concatenate([back @ angular, back @ linear], axis=2),
        omega=np.einsum("nbij,nbj->nbi", back, vectors(SPIN)),
        alpha=np.einsum("nbij,nbj->nbi", back, vectors(ALPHA)),
        xdd=np.einsum("nbij,nbj->nbi", back, vectors(ACCEL)),
        R=R[:, None] @ E,
        x=q[:, None, :3] + np.einsum("nij,nbj->nbi", R, vectors(X)),
        features=features(q, v, R),
    )


def mass_matrices(batch: TreeBatch, system: System) -> Array:
    """M (B, nv, nv): the sum over bodies of m J_v^T J_v + J_w^T I J_w, J_v of the centre of mass.

    Args:
        batch: Of `tree_batch`.
        system: Masses, centres of mass and inertias.
    """
    angular, linear = _jacobians_of_com(batch, system)
    by_mass = np.sqrt(system.mass)[:, None, None] * linear
    M = np.einsum("nbij,nbik->njk", by_mass, by_mass, optimize=True)
    M += np.einsum("nbij,bik,nbkl->njl", angular, system.inertia, angular, optimize=True)
    return np.asarray(M)


def free_accelerations(system: System, q: Array, v: Array) -> Array:
    """dv/dt of states without contact (B, nv): M^-1 k and the learned acceleration [m/s², rad/s²].

    Args:
        system: The simulator's parameters. Its `forces` and `registered` do not enter.
        q: (B, nq) configurations.
        v: (B, nv) velocities.
    """
    batch = tree_batch(system, q, v)
    angular, linear = _jacobians_of_com(batch, system)
    w, arm = batch.omega, np.broadcast_to(system.com, batch.omega.shape)
    # of each body, in its own axes: minus the force m (g - a) on its centre of mass, and I dw/dt + w x I w about it
    a = batch.xdd + np.cross(batch.alpha, arm) + np.cross(w, np.cross(w, arm)) - system.gravity @ batch.R
    spin = np.einsum("bij,nbj->nbi", system.inertia, w)
    moment = np.einsum("bij,nbj->nbi", system.inertia, batch.alpha) + np.cross(w, spin)
    bias = np.einsum("b,nbij,nbi->nj", system.mass, linear, a) + np.einsum("nbij,nbi->nj", angular, moment)
    out: Array = -np.linalg.solve(mass_matrices(batch, system), bias[..., None])[..., 0]
    if len(system.k_res.linear):
        learned = learned_accelerations(system.k_res, batch.features, system.nv)
        out[:, :3] += np.einsum("nij,nj->ni", batch.R[:, 0], learned[:, :3])
        out[:, 3:] += learned[:, 3:]
    return out


def mass_norms(system: System, q: Array, a: Array) -> Array:
    """sqrt(a^T M(q) a) (B,) of accelerations a (B, nv) at configurations q (B, nq).

    Args:
        system: The simulator's parameters.
        q: (B, nq) configurations.
        a: (B, nv) accelerations.
    """
    M = mass_matrices(tree_batch(system, q, np.zeros_like(a)), system)
    return np.sqrt(np.einsum("ni,nij,nj->n", a, M, a))


def _jacobians_of_com(batch: TreeBatch, system: System) -> tuple[Array, Array]:
    """(B, n_b, 3, nv) of the bodies' spins and of their centres of mass, in their own axes."""
    angular = batch.X[:, :, :3]
    return angular, batch.X[:, :, 3:] - skew(system.com) @ angular
