"""Rigid-body dynamics of a kinematic tree with a free base, as Numba kernels.

The equations of motion are M(q) dv/dt + bias(q, v) = J^T f, with v = (world
velocity of the base origin, body angular velocity of the base, joint rates).
M and bias come from the Jacobians of the bodies' centres of mass
(Featherstone, "Rigid Body Dynamics Algorithms", 2008, sec. 6; the projected
Newton-Euler form). Every kernel works on one state and writes into `Work`.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tossid.kernels import fused_kernel, kernel
from tossid.physics.system import System, n_features

Array = NDArray[np.float64]

HINGE = 1  # JointType.HINGE, as a constant that Numba can fold


class Work(NamedTuple):
    """Scratch of one state: poses of bodies, their Jacobians, M and its Cholesky factor."""

    xpos: Array  # (n_b, 3) world position of body frames
    xmat: Array  # (n_b, 3, 3) world rotation of body frames
    axis: Array  # (n_b, 3) world joint axes
    anchor: Array  # (n_b, 3) world joint anchors
    Jv: Array  # (n_b, 3, nv) Jacobian of each centre of mass
    Jw: Array  # (n_b, 3, nv) Jacobian of each body's angular velocity (world)
    omega: Array  # (n_b, 3) angular velocity (world)
    alpha: Array  # (n_b, 3) angular acceleration at dv/dt = 0
    xdd: Array  # (n_b, 3) acceleration of body origins at dv/dt = 0
    M: Array  # (nv, nv)
    L: Array  # (nv, nv) lower Cholesky factor of M
    bias: Array  # (nv,)
    feature: Array  # (n_f,)
    hidden: Array  # (2, h)
    accel: Array  # (nv + 3,)


def make_work(system: System) -> Work:
    """Scratch arrays for `system`."""
    nb, nv = len(system.parent), system.nv
    h = max(len(system.k_res.b0), 1)
    z = np.zeros
    return Work(
        z((nb, 3)),
        z((nb, 3, 3)),
        z((nb, 3)),
        z((nb, 3)),
        z((nb, 3, nv)),
        z((nb, 3, nv)),
        z((nb, 3)),
        z((nb, 3)),
        z((nb, 3)),
        z((nv, nv)),
        z((nv, nv)),
        z(nv),
        z(n_features(nb - 1, world=True)),
        z((2, h)),
        z(nv + 3),
    )


@fused_kernel
def quat_to_mat(w, x, y, z, R):  # type: ignore[no-untyped-def]
    """Rotation matrix of a unit quaternion into R (3, 3)."""
    R[0, 0] = 1 - 2 * (y * y + z * z)
    R[0, 1] = 2 * (x * y - w * z)
    R[0, 2] = 2 * (x * z + w * y)
    R[1, 0] = 2 * (x * y + w * z)
    R[1, 1] = 1 - 2 * (x * x + z * z)
    R[1, 2] = 2 * (y * z - w * x)
    R[2, 0] = 2 * (x * z - w * y)
    R[2, 1] = 2 * (y * z + w * x)
    R[2, 2] = 1 - 2 * (x * x + y * y)


@kernel
def _matvec(R, x, out):  # type: ignore[no-untyped-def]
    for i in range(3):
        out[i] = R[i, 0] * x[0] + R[i, 1] * x[1] + R[i, 2] * x[2]


@kernel
def _cross_add(a, b, scale, out):  # type: ignore[no-untyped-def]
    """out += scale * a x b."""
    out[0] += scale * (a[1] * b[2] - a[2] * b[1])
    out[1] += scale * (a[2] * b[0] - a[0] * b[2])
    out[2] += scale * (a[0] * b[1] - a[1] * b[0])


@kernel
def kinematics(system, q, work):  # type: ignore[no-untyped-def]
    """Poses of all bodies (work.xpos, work.xmat), joint axes and anchors, for q (nq,)."""
    nb = len(system.parent)
    for i in range(3):
        work.xpos[0, i] = q[i]
    quat_to_mat(q[3], q[4], q[5], q[6], work.xmat[0])
    R0 = np.empty((3, 3))
    Rj = np.empty((3, 3))
    x = np.empty(3)
    for b in range(1, nb):
        up = system.parent[b]
        bq = system.body_quat[b]
        quat_to_mat(bq[0], bq[1], bq[2], bq[3], Rj)
        R0[:] = 0.0
        for i in range(3):
            for j in range(3):
                for k in range(3):
                    R0[i, j] += work.xmat[up, i, k] * Rj[k, j]
        _matvec(work.xmat[up], system.body_pos[b], x)
        for i in range(3):
            work.xpos[b, i] = work.xpos[up, i] + x[i]
        _matvec(R0, system.joint_axis[b], work.axis[b])
        _matvec(R0, system.joint_pos[b], x)
        for i in range(3):
            work.anchor[b, i] = work.xpos[b, i] + x[i]
        angle = q[6 + b]
        if system.joint_type[b] == HINGE:
            a = system.joint_axis[b]
            c, s = np.cos(0.5 * angle), np.sin(0.5 * angle)
            quat_to_mat(c, s * a[0], s * a[1], s * a[2], Rj)
            for i in range(3):
                for j in range(3):
                    work.xmat[b, i, j] = R0[i, 0] * Rj[0, j] + R0[i, 1] * Rj[1, j] + R0[i, 2] * Rj[2, j]
            _matvec(work.xmat[b], system.joint_pos[b], x)
            for i in range(3):
                work.xpos[b, i] = work.anchor[b, i] - x[i]
        else:
            for i in range(3):
                for j in range(3):
                    work.xmat[b, i, j] = R0[i, j]
                work.xpos[b, i] += angle * work.axis[b, i]
                work.anchor[b, i] += angle * work.axis[b, i]


@kernel
def point_jacobian(system, work, body, point, J):  # type: ignore[no-untyped-def]
    """Jacobian (3, nv) of a world point fixed to `body`: its world velocity is J v. After `kinematics`."""
    J[:] = 0.0
    r0 = point[0] - work.xpos[0, 0]
    r1 = point[1] - work.xpos[0, 1]
    r2 = point[2] - work.xpos[0, 2]
    R = work.xmat[0]
    for j in range(3):
        J[j, j] = 1.0
        # omega_world x r, with omega_world = R omega_body
        J[0, 3 + j] = R[1, j] * r2 - R[2, j] * r1
        J[1, 3 + j] = R[2, j] * r0 - R[0, j] * r2
        J[2, 3 + j] = R[0, j] * r1 - R[1, j] * r0
    b = body
    while b > 0:
        a = work.axis[b]
        col = 5 + b
        if system.joint_type[b] == HINGE:
            d0 = point[0] - work.anchor[b, 0]
            d1 = point[1] - work.anchor[b, 1]
            d2 = point[2] - work.anchor[b, 2]
            J[0, col] = a[1] * d2 - a[2] * d1
            J[1, col] = a[2] * d0 - a[0] * d2
            J[2, col] = a[0] * d1 - a[1] * d0
        else:
            for i in range(3):
                J[i, col] = a[i]
        b = system.parent[b]


@kernel
def mass_matrix(system, work):  # type: ignore[no-untyped-def]
    """M(q) (nv, nv) into work.M, and the Jacobians of centres of mass. After `kinematics`."""
    nb = len(system.parent)
    nv = 5 + nb
    com = np.empty(3)
    Iw = np.empty((3, 3))
    RI = np.empty((3, 3))
    IJ = np.empty((3, nv))
    work.M[:] = 0.0
    for b in range(nb):
        R = work.xmat[b]
        _matvec(R, system.com[b], com)
        for i in range(3):
            com[i] += work.xpos[b, i]
        Jv, Jw = work.Jv[b], work.Jw[b]
        point_jacobian(system, work, b, com, Jv)
        Jw[:] = 0.0
        for i in range(3):
            for j in range(3):
                Jw[i, 3 + j] = work.xmat[0, i, j]
        up = b
        while up > 0:
            if system.joint_type[up] == HINGE:
                for i in range(3):
                    Jw[i, 5 + up] = work.axis[up, i]
            up = system.parent[up]
        for i in range(3):
            for j in range(3):
                RI[i, j] = (
                    R[i, 0] * system.inertia[b, 0, j]
                    + R[i, 1] * system.inertia[b, 1, j]
                    + R[i, 2] * system.inertia[b, 2, j]
                )
        for i in range(3):
            for j in range(3):
                Iw[i, j] = RI[i, 0] * R[j, 0] + RI[i, 1] * R[j, 1] + RI[i, 2] * R[j, 2]
        m = system.mass[b]
        for i in range(3):
            for j in range(3, nv):
                IJ[i, j] = Iw[i, 0] * Jw[0, j] + Iw[i, 1] * Jw[1, j] + Iw[i, 2] * Jw[2, j]
        for i in range(nv):
            for j in range(i + 1):
                s = m * (Jv[0, i] * Jv[0, j] + Jv[1, i] * Jv[1, j] + Jv[2, i] * Jv[2, j])
                if j >= 3:
                    s += Jw[0, i] * IJ[0, j] + Jw[1, i] * IJ[1, j] + Jw[2, i] * IJ[2, j]
                work.M[i, j] += s
    for i in range(nv):
        for j in range(i):
            work.M[j, i] = work.M[i, j]


@kernel
def bias_force(system, q, v, work):  # type: ignore[no-untyped-def]
    """bias(q, v) (nv,) into work.bias: Coriolis, centrifugal, gyroscopic and gravity. After `mass_matrix`."""
    nb = len(system.parent)
    nv = 5 + nb
    r = np.empty(3)
    t = np.empty(3)
    h = np.empty(3)
    f = np.empty(3)
    n = np.empty(3)
    local = np.empty(3)
    work.bias[:] = 0.0
    _matvec(work.xmat[0], v[3:6], work.omega[0])
    work.alpha[0, :] = 0.0
    work.xdd[0, :] = 0.0
    for b in range(nb):
        if b > 0:
            up = system.parent[b]
            rate = v[5 + b]
            a = work.axis[b]
            wu = work.omega[up]
            # the joint's anchor as a point of the parent
            for i in range(3):
                r[i] = work.anchor[b, i] - work.xpos[up, i]
                work.xdd[b, i] = work.xdd[up, i]
                work.alpha[b, i] = work.alpha[up, i]
                work.omega[b, i] = wu[i]
            _cross_add(work.alpha[up], r, 1.0, work.xdd[b])
            t[:] = 0.0
            _cross_add(wu, r, 1.0, t)
            _cross_add(wu, t, 1.0, work.xdd[b])
            if system.joint_type[b] == HINGE:
                _cross_add(wu, a, rate, work.alpha[b])
                for i in range(3):
                    work.omega[b, i] += rate * a[i]
                    r[i] = work.xpos[b, i] - work.anchor[b, i]
                _cross_add(work.alpha[b], r, 1.0, work.xdd[b])
                t[:] = 0.0
                _cross_add(work.omega[b], r, 1.0, t)
                _cross_add(work.omega[b], t, 1.0, work.xdd[b])
            else:
                _cross_add(wu, a, 2.0 * rate, work.xdd[b])
                # anchor moves with the slide; from there to the body's origin it is a fixed arm
                for i in range(3):
                    r[i] = work.xpos[b, i] - work.anchor[b, i]
                _cross_add(work.alpha[b], r, 1.0, work.xdd[b])
                t[:] = 0.0
                _cross_add(work.omega[b], r, 1.0, t)
                _cross_add(work.omega[b], t, 1.0, work.xdd[b])
        R = work.xmat[b]
        w = work.omega[b]
        _matvec(R, system.com[b], r)
        t[:] = 0.0
        _cross_add(w, r, 1.0, t)
        m = system.mass[b]
        for i in range(3):
            f[i] = work.xdd[b, i] - system.gravity[i]
        _cross_add(work.alpha[b], r, 1.0, f)
        _cross_add(w, t, 1.0, f)
        # moment: I alpha + w x I w, in world axes
        for i in range(3):
            local[i] = R[0, i] * w[0] + R[1, i] * w[1] + R[2, i] * w[2]
        _matvec(system.inertia[b], local, t)
        _matvec(R, t, h)
        n[:] = 0.0
        _cross_add(w, h, 1.0, n)
        al = work.alpha[b]
        for i in range(3):
            local[i] = R[0, i] * al[0] + R[1, i] * al[1] + R[2, i] * al[2]
        _matvec(system.inertia[b], local, t)
        _matvec(R, t, h)
        for j in range(nv):
            s = 0.0
            for i in range(3):
                s += m * work.Jv[b, i, j] * f[i] + work.Jw[b, i, j] * (n[i] + h[i])
            work.bias[j] += s


@kernel
def cholesky(A, L, n):  # type: ignore[no-untyped-def]
    """Lower factor of A (n, n) into L. False if A is not positive definite."""
    for i in range(n):
        for j in range(i + 1):
            s = A[i, j]
            for k in range(j):
                s -= L[i, k] * L[j, k]
            if i == j:
                if s <= 0.0:
                    return False
                L[i, i] = np.sqrt(s)
            else:
                L[i, j] = s / L[j, j]
    return True


@kernel
def cholesky_solve(L, x, n):  # type: ignore[no-untyped-def]
    """x (n,) <- (L L^T)^-1 x, in place."""
    for i in range(n):
        s = x[i]
        for k in range(i):
            s -= L[i, k] * x[k]
        x[i] = s / L[i, i]
    for i in range(n - 1, -1, -1):
        s = x[i]
        for k in range(i + 1, n):
            s -= L[k, i] * x[k]
        x[i] = s / L[i, i]
