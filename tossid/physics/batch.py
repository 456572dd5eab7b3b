"""The parts of a tree's dynamics that depend on the motion alone, for batches of states.

With these, M, bias and contact Jacobians are linear in the inertial parameters
(mass, first moment, moments about the body's origin) and in the corners'
positions, so that a model can learn both by automatic differentiation without
differentiating through kinematics.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tossid.kernels import kernel
from tossid.physics.free import features
from tossid.physics.registered_forces import NoForce
from tossid.physics.system import LearnedAcceleration, System, n_features
from tossid.physics.tree import bias_force, kinematics, make_work, mass_matrix, point_jacobian

Array = NDArray[np.float64]


class TreeBatch(NamedTuple):
    """Kinematic quantities of B states.

    X: (B, n_b, 6, nv) each body's Jacobian in its own axes: angular rows, then
        linear rows of its frame's origin.
    omega: (B, n_b, 3) angular velocity, body axes [rad/s].
    alpha, xdd: (B, n_b, 3) angular acceleration and the origin's acceleration at
        dv/dt = 0, body axes.
    R: (B, n_b, 3, 3) world rotation of the bodies; x: (B, n_b, 3) world position.
    features: (B, n_f) the learned acceleration's input, with the features of the world.
    """

    X: Array
    omega: Array
    alpha: Array
    xdd: Array
    R: Array
    x: Array
    features: Array


@kernel
def _fill(system, work, q, v, X, omega, alpha, xdd, R, x, feature):  # type: ignore[no-untyped-def]
    nb = len(system.parent)
    nv = v.shape[1]
    Jp = np.empty((3, nv))
    for s in range(len(q)):
        kinematics(system, q[s], work)
        mass_matrix(system, work)
        bias_force(system, q[s], v[s], work)
        features(system, q[s], v[s], work)
        feature[s] = work.feature
        for b in range(nb):
            Rb = work.xmat[b]
            R[s, b] = Rb
            x[s, b] = work.xpos[b]
            point_jacobian(system, work, b, work.xpos[b], Jp)
            for i in range(3):
                omega[s, b, i] = Rb[0, i] * work.omega[b, 0] + Rb[1, i] * work.omega[b, 1] + Rb[2, i] * work.omega[b, 2]
                alpha[s, b, i] = Rb[0, i] * work.alpha[b, 0] + Rb[1, i] * work.alpha[b, 1] + Rb[2, i] * work.alpha[b, 2]
                xdd[s, b, i] = Rb[0, i] * work.xdd[b, 0] + Rb[1, i] * work.xdd[b, 1] + Rb[2, i] * work.xdd[b, 2]
                for j in range(nv):
                    Jw = work.Jw[b]
                    X[s, b, i, j] = Rb[0, i] * Jw[0, j] + Rb[1, i] * Jw[1, j] + Rb[2, i] * Jw[2, j]
                    X[s, b, 3 + i, j] = Rb[0, i] * Jp[0, j] + Rb[1, i] * Jp[1, j] + Rb[2, i] * Jp[2, j]


def learned_accelerations(k_res: LearnedAcceleration, features: Array, nv: int) -> Array:
    """The learned acceleration in the base's axes (N, nv) [m/s², rad/s²].

    Args:
        k_res: The function.
        features: (N, n_f or more), of `tree_batch`.
        nv: Length of a velocity.
    """
    f = features[:, : k_res.linear.shape[1]]
    hidden = np.tanh(np.tanh(f @ k_res.W0.T + k_res.b0) @ k_res.W1.T + k_res.b1)
    found = f @ k_res.linear.T + hidden @ k_res.W2.T
    out: Array = found[:, :nv].copy()
    if found.shape[1] > nv:
        out[:, :3] += to_base(features, found[:, nv:], nv - 6)
    return out


def to_base(features, along_world, n_joints):  # type: ignore[no-untyped-def]
    """Vectors (N, 3) along the world's axes in the base's, whose features (N, n_f) of `tree_batch` are known.

    Arrays or tensors.
    """
    first = n_features(n_joints)
    x, y, z = features[:, first : first + 3], features[:, first + 3 : first + 6], features[:, :3]
    return along_world[:, :1] * x + along_world[:, 1:2] * y + along_world[:, 2:] * z


def tree_batch(system: System, q: Array, v: Array) -> TreeBatch:
    """Kinematic quantities of states q (B, nq), v (B, nv); inertia and contact do not enter."""
    q, v = np.ascontiguousarray(q, dtype=float), np.ascontiguousarray(v, dtype=float)
    system = system._replace(registered=NoForce())  # of no use here, and else one more type to compile for
    B, nb, nv = len(q), len(system.parent), system.nv
    work = make_work(system)
    out = TreeBatch(
        X=np.empty((B, nb, 6, nv)),
        omega=np.empty((B, nb, 3)),
        alpha=np.empty((B, nb, 3)),
        xdd=np.empty((B, nb, 3)),
        R=np.empty((B, nb, 3, 3)),
        x=np.empty((B, nb, 3)),
        features=np.empty((B, len(work.feature))),
    )
    _fill(system, work, q, v, *out)
    return out
