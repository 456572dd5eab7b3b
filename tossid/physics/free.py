"""Free motion: dv/dt without contact of any tree, with the learned acceleration.

Plain and general: M and bias from the bodies' Jacobians. The time stepper's kernels (`articulated`, `body`)
are others, and tests hold them to this.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tossid.kernels import kernel
from tossid.physics.system import System
from tossid.physics.tree import bias_force, cholesky, cholesky_solve, kinematics, make_work, mass_matrix

Array = NDArray[np.float64]


@kernel
def features(system, q, v, work):  # type: ignore[no-untyped-def]
    """The learned acceleration's features into work.feature: what the base sees, in its own frame.

    (vertical R^T e_z, |v| R^T v [m²/s²], spin [rad/s] / 10, then sin, cos and rate / 10 of each joint). Velocity
    enters as its square: drag at a toss's speeds grows so, and what flight taught must not push what slides slowly.

    Then what the base sees of the world: its x and y axes (R^T e_x, R^T e_y), 1, position [m] and velocity [m/s] along
    the world's axes.
    """
    R = work.xmat[0]
    f = work.feature
    speed = np.sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2])
    for i in range(3):
        f[i] = R[2, i]
        f[3 + i] = speed * (R[0, i] * v[0] + R[1, i] * v[1] + R[2, i] * v[2])
        f[6 + i] = 0.1 * v[3 + i]
    for b in range(1, len(system.parent)):
        f[6 + 3 * b] = np.sin(q[6 + b])
        f[7 + 3 * b] = np.cos(q[6 + b])
        f[8 + 3 * b] = 0.1 * v[5 + b]
    n = 6 + 3 * len(system.parent)
    f[n + 6] = 1.0
    for i in range(3):
        f[n + i], f[n + 3 + i] = R[0, i], R[1, i]
        f[n + 7 + i], f[n + 10 + i] = q[i], v[i]


@kernel
def learned_acceleration(system, q, v, work, out):  # type: ignore[no-untyped-def]
    """a_res(q, v) added to out (nv,). After `kinematics`."""
    net = system.k_res
    if net.linear.shape[0] == 0:
        return
    features(system, q, v, work)
    f = work.feature
    nf, h, nv = net.linear.shape[1], net.b0.shape[0], out.shape[0]
    n_out = net.linear.shape[0]
    h0, h1 = work.hidden[0], work.hidden[1]
    for i in range(h):
        s = net.b0[i]
        for j in range(nf):
            s += net.W0[i, j] * f[j]
        h0[i] = np.tanh(s)
    for i in range(h):
        s = net.b1[i]
        for j in range(h):
            s += net.W1[i, j] * h0[j]
        h1[i] = np.tanh(s)
    local = work.accel
    for i in range(n_out):
        s = 0.0
        for j in range(nf):
            s += net.linear[i, j] * f[j]
        for j in range(h):
            s += net.W2[i, j] * h1[j]
        local[i] = s
    R = work.xmat[0]
    for i in range(3):
        out[i] += R[i, 0] * local[0] + R[i, 1] * local[1] + R[i, 2] * local[2]
    for i in range(3, nv):
        out[i] += local[i]
    for i in range(n_out - nv):
        out[i] += local[nv + i]


@kernel
def free_acceleration(system, q, v, work, out):  # type: ignore[no-untyped-def]
    """dv/dt without contact, M^-1 k + a_res, into out (nv,); leaves poses, M, its factor and bias in `work`.

    Returns False if M is not positive definite.
    """
    nv = out.shape[0]
    kinematics(system, q, work)
    mass_matrix(system, work)
    bias_force(system, q, v, work)
    if not cholesky(work.M, work.L, nv):
        return False
    for i in range(nv):
        out[i] = -work.bias[i]
    cholesky_solve(work.L, out, nv)
    learned_acceleration(system, q, v, work, out)
    return True


@kernel
def _fill(system, q, v, work, out):  # type: ignore[no-untyped-def]
    for n in range(len(q)):
        free_acceleration(system, q[n], v[n], work, out[n])


def free_accelerations(system: System, q: Array, v: Array) -> Array:
    """dv/dt of states without contact (N, nv), as `free_acceleration` has it.

    Args:
        system: The simulator's parameters.
        q: (N, nq) configurations.
        v: (N, nv) velocities.
    """
    out = np.empty((len(q), system.nv))
    _fill(system, np.ascontiguousarray(q, dtype=float), np.ascontiguousarray(v, dtype=float), make_work(system), out)
    return out


@kernel
def mass_norms(system, q, a, work, out):  # type: ignore[no-untyped-def]
    """sqrt(a^T M(q) a) of accelerations a (N, nv) at configurations q (N, nq) into out (N,)."""
    nv = a.shape[1]
    for n in range(len(q)):
        kinematics(system, q[n], work)
        mass_matrix(system, work)
        square = 0.0
        for i in range(nv):
            for j in range(nv):
                square += a[n, i] * work.M[i, j] * a[n, j]
        out[n] = np.sqrt(square)
