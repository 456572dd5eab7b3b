"""What acts on a tree beside gravity and contact: forces of the state, its joints, and what contact holds.

Forces of the state (`forces.Forces`) are those of the whole object, shared out by mass: body b of mass m_b feels
m_b / m of what a single body of the whole mass m would feel at b's centre of mass, with b's own velocity and spin. So a
uniform force moves no joint, linear drag slows every body at the same rate, and an object whose joints are locked feels
what a single body does.

A joint's torque is taken at the step's mean rate and angle, r + h/2 dr/dt and angle + h/2 (r + h/2 dr/dt),

    torque = -c r - k (angle - rest + h/2 r),     S_jj += armature + h/2 c + h²/4 k

which is stable for any damping c. Its Coulomb friction takes from the rate, before contact, an impulse of at most h
times friction, and no more than stops it; so do the resistances of a contact to spin (`forces.Law`), for each body by
the load that its own corners carried in the step before, or take up in an impact.
"""

from __future__ import annotations

import math

import numpy as np

from tossid.kernels import fused_kernel
from tossid.physics.articulated import (
    ANCHOR,
    AXIS,
    FORCE,
    INERTIA,
    SPIN,
    TORQUE,
    X,
    back,
    contact_row,
    cross,
    spin_row,
    turned,
)
from tossid.physics.forces import ADHESION_REACH, grown, push
from tossid.physics.forces import SPIN as SPIN_POWER
from tossid.physics.tree import HINGE

SWEEPS = 8
"""Over the joints that rub, if there are several: each changes the others' rates."""


@fused_kernel
def pull(forces, gravity, parent, joint_type, mass, com, total, h, R, q, v, P, E, U):  # type: ignore[no-untyped-def]
    """Put the forces of the state on the bodies: into their bias and, for spin's drag, inertia. After `own`.

    total: mass of the tree [kg]. U (n_b, 3): scratch, velocities of the bodies' origins in the base's axes.
    """
    nowhere = np.zeros(3)
    for b in range(parent.shape[0]):
        w0, w1, w2 = P[b, SPIN], P[b, SPIN + 1], P[b, SPIN + 2]
        if b == 0:
            for i in range(3):
                U[0, i] = R[0, i] * v[0] + R[1, i] * v[1] + R[2, i] * v[2]
        else:
            up = parent[b]
            k0, k1, k2 = P[b, ANCHOR], P[b, ANCHOR + 1], P[b, ANCHOR + 2]
            s0, s1, s2 = cross(
                P[up, SPIN], P[up, SPIN + 1], P[up, SPIN + 2], k0 - P[up, X], k1 - P[up, X + 1], k2 - P[up, X + 2]
            )
            t0, t1, t2 = cross(w0, w1, w2, P[b, X] - k0, P[b, X + 1] - k1, P[b, X + 2] - k2)
            rate = 0.0 if joint_type[b] == HINGE else v[5 + b]
            U[b, 0] = U[up, 0] + s0 + t0 + rate * P[b, AXIS]
            U[b, 1] = U[up, 1] + s1 + t1 + rate * P[b, AXIS + 1]
            U[b, 2] = U[up, 2] + s2 + t2 + rate * P[b, AXIS + 2]
        c0, c1, c2 = turned(E, b, com[b, 0], com[b, 1], com[b, 2])
        d0, d1, d2 = P[b, X] + c0, P[b, X + 1] + c1, P[b, X + 2] + c2
        s0, s1, s2 = cross(w0, w1, w2, c0, c1, c2)
        s0, s1, s2 = U[b, 0] + s0, U[b, 1] + s1, U[b, 2] + s2
        m0, m1, m2 = push(
            forces, gravity, 1.0 / total, h, R, nowhere,
            q[0] + R[0, 0] * d0 + R[0, 1] * d1 + R[0, 2] * d2,
            q[1] + R[1, 0] * d0 + R[1, 1] * d1 + R[1, 2] * d2,
            q[2] + R[2, 0] * d0 + R[2, 1] * d1 + R[2, 2] * d2,
            R[0, 0] * s0 + R[0, 1] * s1 + R[0, 2] * s2,
            R[1, 0] * s0 + R[1, 1] * s1 + R[1, 2] * s2,
            R[2, 0] * s0 + R[2, 1] * s1 + R[2, 2] * s2,
            w0, w1, w2, w0, w1, w2,
        )  # fmt: skip
        s = mass[b] / h
        f0 = s * (R[0, 0] * m0 + R[1, 0] * m1 + R[2, 0] * m2)
        f1 = s * (R[0, 1] * m0 + R[1, 1] * m1 + R[2, 1] * m2)
        f2 = s * (R[0, 2] * m0 + R[1, 2] * m1 + R[2, 2] * m2)
        t0, t1, t2 = cross(d0, d1, d2, f0, f1, f2)
        s = forces.spin * grown(forces, SPIN_POWER, w0, w1, w2) * mass[b] / total
        P[b, FORCE], P[b, FORCE + 1], P[b, FORCE + 2] = P[b, FORCE] - f0, P[b, FORCE + 1] - f1, P[b, FORCE + 2] - f2
        P[b, TORQUE] -= t0 - s * w0
        P[b, TORQUE + 1] -= t1 - s * w1
        P[b, TORQUE + 2] -= t2 - s * w2
        for i in range(3):
            P[b, INERTIA + i] += 0.5 * h * s


@fused_kernel
def drive(joints, h, q, v, torque, slack):  # type: ignore[no-untyped-def]
    """Torque of each joint and what it adds to S's diagonal, (n_b,) each, as the module says."""
    for b in range(1, torque.shape[0]):
        c, k, rate = joints.damping[b], joints.stiffness[b], v[5 + b]
        torque[b] = -c * rate - k * (q[6 + b] - joints.rest[b] + 0.5 * h * rate)
        slack[b] = joints.armature[b] + 0.5 * h * c + 0.25 * h * h * k


@fused_kernel
def answer(L, y, n):  # type: ignore[no-untyped-def]
    """y (n,) <- S^-1 y, with L as `factor` leaves it."""
    for i in range(n):
        s = y[i]
        for k in range(i):
            s -= L[i, k] * y[k]
        y[i] = s * L[i, i]
    back(L, y, n)


@fused_kernel
def rub(friction, h, L, y, taken, xi):  # type: ignore[no-untyped-def]
    """Take the joints' Coulomb friction from their rates in xi. y (n_x,), taken (n_b,): scratch."""
    nb, nx = friction.shape[0], xi.shape[0]
    taken[:] = 0.0
    for _ in range(1 if nb == 2 else SWEEPS):
        for b in range(1, nb):
            if friction[b] == 0.0:
                continue
            y[:] = 0.0
            y[2 + b] = 1.0
            answer(L, y, nx)
            bound = h * friction[b]
            impulse = min(max(taken[b] - xi[2 + b] / y[2 + b], -bound), bound)
            for x in range(nx):
                xi[x] += (impulse - taken[b]) * y[x]
            taken[b] = impulse


@fused_kernel
def resist(impulse, L, row, y, xi):  # type: ignore[no-untyped-def]
    """Take an angular impulse [N m s] against the spin row . xi, no more than stops it. y: scratch."""
    nx, spin, size = xi.shape[0], 0.0, 0.0
    for x in range(nx):
        y[x] = row[x]
        spin += row[x] * xi[x]
    answer(L, y, nx)
    for x in range(nx):
        size += row[x] * y[x]
    s = math.copysign(min(impulse, abs(spin) / size), spin)
    for x in range(nx):
        xi[x] -= s * y[x]


@fused_kernel
def hold_bodies(  # type: ignore[no-untyped-def]
    law, parent, joint_type, corner_body, place, height, over_m, h, R, P, L, warm, cold, row, y, u, xi
):
    """Adhesion's pull on u (3: z, x, y) and xi (n_x,), and each body's resistance to its spin; as `forces.hold`.

    place (n_c, 3): corners from the base's origin, base axes. height (n_c,) [m]. row (1, 1, n_x), y (n_x,): scratch.
    """
    nx, nc = xi.shape[0], corner_body.shape[0]
    pull_of_corner = h * law.adhesion
    for c in range(nc):
        if law.adhesion != 0.0 and ((not cold and warm[c, 0] > 0.0) or height[c] < ADHESION_REACH):
            contact_row(
                parent, joint_type, P, corner_body[c], place[c, 0], place[c, 1], place[c, 2],
                R[2, 0], R[2, 1], R[2, 2], 0, 0, row,
            )  # fmt: skip
            for x in range(nx):
                y[x] = row[0, 0, x]
            answer(L, y, nx)
            u[0] -= pull_of_corner * over_m
            for x in range(nx):
                xi[x] -= pull_of_corner * y[x]
    if not cold:
        resist_spins(law, parent, joint_type, corner_body, R, P, L, warm, row, y, xi)


@fused_kernel
def resist_spins(law, parent, joint_type, corner_body, R, P, L, carried, row, y, xi):  # type: ignore[no-untyped-def]
    """Take from xi (n_x,) what contact resists of each body's spin, of its corners' normal impulses carried[:, 0]."""
    nx, nc = xi.shape[0], corner_body.shape[0]
    if law.torsional == 0.0 and law.rolling == 0.0:
        return
    for b in range(parent.shape[0]):
        load = 0.0
        for c in range(nc):
            if corner_body[c] == b:
                load += carried[c, 0]
        if load == 0.0:
            continue
        spin_row(parent, joint_type, P, b, R[2, 0], R[2, 1], R[2, 2], row[0, 0])
        resist(law.torsional * load, L, row[0, 0], y, xi)
        across = np.zeros(2)
        for i in range(2):
            spin_row(parent, joint_type, P, b, R[i, 0], R[i, 1], R[i, 2], row[0, 0])
            for x in range(nx):
                across[i] += row[0, 0, x] * xi[x]
        size = math.sqrt(across[0] * across[0] + across[1] * across[1])
        if size > 0.0:
            d0, d1 = across[0] / size, across[1] / size
            spin_row(
                parent, joint_type, P, b,
                d0 * R[0, 0] + d1 * R[1, 0], d0 * R[0, 1] + d1 * R[1, 1], d0 * R[0, 2] + d1 * R[1, 2], row[0, 0],
            )  # fmt: skip
            resist(law.rolling * load, L, row[0, 0], y, xi)
