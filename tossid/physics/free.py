"""Free motion: dv/dt without contact, of a tree or of a single body, with the learned residual."""

from __future__ import annotations

import numba
import numpy as np

from tossid.physics.tree import bias_force, cholesky, cholesky_solve, kinematics, mass_matrix, quat_to_mat

njit = numba.njit(cache=True, error_model="numpy")


@njit
def features(system, q, v, work):  # type: ignore[no-untyped-def]
    """The residual's features into work.feature: what the base sees, in its own frame.

    (vertical R^T e_z, velocity R^T v [m/s], spin [rad/s] / 10, then sin, cos and rate / 10 of each joint)
    """
    R = work.xmat[0]
    f = work.feature
    for i in range(3):
        f[i] = R[2, i]
        f[3 + i] = R[0, i] * v[0] + R[1, i] * v[1] + R[2, i] * v[2]
        f[6 + i] = 0.1 * v[3 + i]
    for b in range(1, len(system.parent)):
        f[6 + 3 * b] = np.sin(q[6 + b])
        f[7 + 3 * b] = np.cos(q[6 + b])
        f[8 + 3 * b] = 0.1 * v[5 + b]


@njit
def residual_acceleration(system, q, v, work, out):  # type: ignore[no-untyped-def]
    """a_res(q, v) added to out (nv,). After `kinematics`."""
    net = system.residual
    if net.linear.shape[0] == 0:
        return
    features(system, q, v, work)
    f = work.feature
    nf, h, nv = f.shape[0], net.b0.shape[0], out.shape[0]
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
    for i in range(nv):
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


@njit
def body_acceleration(system, q, v, work, out):  # type: ignore[no-untyped-def]
    """The same for a single body without residual, in closed form (Newton and Euler about the centre of mass).

    M = [[m 1, -R m c^], [m c^ R^T, I + ..]] has the factor [[sqrt(m) 1, 0], [sqrt(m) c^ R^T, chol(I)]].
    """
    R, L, I = work.xmat[0], work.L, system.inertia[0]
    for i in range(3):
        work.xpos[0, i] = q[i]
    quat_to_mat(q[3], q[4], q[5], q[6], R)
    m = system.mass[0]
    c0, c1, c2 = system.com[0, 0], system.com[0, 1], system.com[0, 2]
    w0, w1, w2 = v[3], v[4], v[5]
    if not (m > 0.0 and I[0, 0] > 0.0):
        return False
    # Cholesky factor of I
    l00 = np.sqrt(I[0, 0])
    l10, l20 = I[1, 0] / l00, I[2, 0] / l00
    d = I[1, 1] - l10 * l10
    if not d > 0.0:
        return False
    l11 = np.sqrt(d)
    l21 = (I[2, 1] - l20 * l10) / l11
    d = I[2, 2] - l20 * l20 - l21 * l21
    if not d > 0.0:
        return False
    l22 = np.sqrt(d)
    root = np.sqrt(m)
    for i in range(3):
        for j in range(i):
            L[i, j] = 0.0
        L[i, i] = root
        L[3, i] = root * (c1 * R[i, 2] - c2 * R[i, 1])
        L[4, i] = root * (c2 * R[i, 0] - c0 * R[i, 2])
        L[5, i] = root * (c0 * R[i, 1] - c1 * R[i, 0])
    L[3, 3], L[4, 3], L[5, 3], L[4, 4], L[5, 4], L[5, 5] = l00, l10, l20, l11, l21, l22
    # angular acceleration: -I^-1 (w x I w)
    h0 = I[0, 0] * w0 + I[0, 1] * w1 + I[0, 2] * w2
    h1 = I[1, 0] * w0 + I[1, 1] * w1 + I[1, 2] * w2
    h2 = I[2, 0] * w0 + I[2, 1] * w1 + I[2, 2] * w2
    a0 = (w2 * h1 - w1 * h2) / l00
    a1 = (w0 * h2 - w2 * h0 - l10 * a0) / l11
    a2 = (w1 * h0 - w0 * h1 - l20 * a0 - l21 * a1) / l22
    a2 = a2 / l22
    a1 = (a1 - l21 * a2) / l11
    a0 = (a0 - l10 * a1 - l20 * a2) / l00
    out[3], out[4], out[5] = a0, a1, a2
    # the origin's acceleration: g - R (a x c + w x (w x c))
    t0, t1, t2 = w1 * c2 - w2 * c1, w2 * c0 - w0 * c2, w0 * c1 - w1 * c0
    e0 = a1 * c2 - a2 * c1 + w1 * t2 - w2 * t1
    e1 = a2 * c0 - a0 * c2 + w2 * t0 - w0 * t2
    e2 = a0 * c1 - a1 * c0 + w0 * t1 - w1 * t0
    for i in range(3):
        out[i] = system.gravity[i] - (R[i, 0] * e0 + R[i, 1] * e1 + R[i, 2] * e2)
    return True


@njit
def free_acceleration(system, q, v, work, out):  # type: ignore[no-untyped-def]
    """dv/dt without contact, M^-1 k + a_res, into out (nv,); leaves the poses and M's factor in `work`.

    For more than one body it also leaves M and bias. Returns False if M is not positive definite.
    """
    nv = out.shape[0]
    if nv == 6:
        good = body_acceleration(system, q, v, work, out)
        residual_acceleration(system, q, v, work, out)
        return good
    kinematics(system, q, work)
    mass_matrix(system, work)
    bias_force(system, q, v, work)
    if not cholesky(work.M, work.L, nv):
        return False
    for i in range(nv):
        out[i] = -work.bias[i]
    cholesky_solve(work.L, out, nv)
    residual_acceleration(system, q, v, work, out)
    return True
