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

from tossid.kernels import fused_lean_kernel
from tossid.physics.articulated import (
    ANCHOR,
    AXIS,
    FORCE,
    HINGE,
    INERTIA,
    SPIN,
    TORQUE,
    X,
    cross,
    rotated,
)
from tossid.physics.cholesky import solve_rates
from tossid.physics.forces import SPIN as SPIN_POWER
from tossid.physics.forces import power_factor, to_world, velocity_change
from tossid.physics.registered_forces import wrench_of

SWEEPS = 8
"""Over the joints that rub, if there are several: each changes the others' rates."""


@fused_lean_kernel
def add_forces(model, work, s, h):  # type: ignore[no-untyped-def]
    """Add the forces of the state to the bodies' bias and, for spin drag, inertia. After `own_inertia_and_bias`.

    A body of mass m_b gets m_b / m of the force on a single body of the whole mass m with its own state.
    """
    forces, gravity, total, tree = model.forces, model.gravity, model.total, model.tree
    parent, joint_type, mass, com = tree.parent, tree.joint_type, tree.mass, tree.com
    R, q, v, P, E, U = s.R, s.q, s.v, work.P, work.E, work.U
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
        c0, c1, c2 = rotated(E, b, com[b, 0], com[b, 1], com[b, 2])
        d0, d1, d2 = P[b, X] + c0, P[b, X + 1] + c1, P[b, X + 2] + c2
        s0, s1, s2 = cross(w0, w1, w2, c0, c1, c2)
        s0, s1, s2 = U[b, 0] + s0, U[b, 1] + s1, U[b, 2] + s2
        position = (
            q[0] + R[0, 0] * d0 + R[0, 1] * d1 + R[0, 2] * d2,
            q[1] + R[1, 0] * d0 + R[1, 1] * d1 + R[1, 2] * d2,
            q[2] + R[2, 0] * d0 + R[2, 1] * d1 + R[2, 2] * d2,
        )
        velocity = (
            R[0, 0] * s0 + R[0, 1] * s1 + R[0, 2] * s2,
            R[1, 0] * s0 + R[1, 1] * s1 + R[1, 2] * s2,
            R[2, 0] * s0 + R[2, 1] * s1 + R[2, 2] * s2,
        )
        spin = (w0, w1, w2)
        m0, m1, m2 = velocity_change(
            forces, model.registered, gravity, 1.0 / total, h, R, position, velocity, spin, spin
        )
        share = mass[b] / h
        f0 = share * (R[0, 0] * m0 + R[1, 0] * m1 + R[2, 0] * m2)
        f1 = share * (R[0, 1] * m0 + R[1, 1] * m1 + R[2, 1] * m2)
        f2 = share * (R[0, 2] * m0 + R[1, 2] * m1 + R[2, 2] * m2)
        t0, t1, t2 = cross(d0, d1, d2, f0, f1, f2)
        drag = forces.spin * power_factor(forces, SPIN_POWER, w0, w1, w2) * mass[b] / total
        P[b, FORCE], P[b, FORCE + 1], P[b, FORCE + 2] = P[b, FORCE] - f0, P[b, FORCE + 1] - f1, P[b, FORCE + 2] - f2
        P[b, TORQUE] -= t0 - drag * w0
        P[b, TORQUE + 1] -= t1 - drag * w1
        P[b, TORQUE + 2] -= t2 - drag * w2
        _, (n0, n1, n2) = wrench_of(model.registered, position, velocity, to_world(R, w0, w1, w2))
        part = mass[b] / total
        P[b, TORQUE] -= part * (R[0, 0] * n0 + R[1, 0] * n1 + R[2, 0] * n2)
        P[b, TORQUE + 1] -= part * (R[0, 1] * n0 + R[1, 1] * n1 + R[2, 1] * n2)
        P[b, TORQUE + 2] -= part * (R[0, 2] * n0 + R[1, 2] * n1 + R[2, 2] * n2)
        for i in range(3):
            P[b, INERTIA + i] += 0.5 * h * drag


@fused_lean_kernel
def joint_torques(joints, h, q, v, torque, slack):  # type: ignore[no-untyped-def]
    """Torque [N m] of each joint and what it adds to S's diagonal, (n_b,) each, by the module's equation."""
    for b in range(1, torque.shape[0]):
        c, k, rate = joints.damping[b], joints.stiffness[b], v[5 + b]
        torque[b] = -c * rate - k * (q[6 + b] - joints.rest[b] + 0.5 * h * rate)
        slack[b] = joints.armature[b] + 0.5 * h * c + 0.25 * h * h * k


@fused_lean_kernel
def resist_joints(friction, h, L, y, taken, xi):  # type: ignore[no-untyped-def]
    """Take the joints' Coulomb friction from their rates in xi, by projected Gauss-Seidel over the joints.

    friction (n_b,) [N m]. y (n_x,), taken (n_b,): scratch.
    """
    nb, nx = friction.shape[0], xi.shape[0]
    for b in range(nb):
        taken[b] = 0.0
    for _ in range(1 if nb == 2 else SWEEPS):
        for b in range(1, nb):
            if friction[b] == 0.0:
                continue
            for x in range(nx):
                y[x] = 0.0
            y[2 + b] = 1.0  # y = S^-1 e_b: the rates that a unit impulse in joint b makes
            solve_rates(L, y, nx)
            bound = h * friction[b]
            impulse = min(max(taken[b] - xi[2 + b] / y[2 + b], -bound), bound)
            for x in range(nx):
                xi[x] += (impulse - taken[b]) * y[x]
            taken[b] = impulse
