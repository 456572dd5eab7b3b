"""Free motion and contact rows of a tree in the base's axes, about the centre of mass of the whole.

With u the velocity of the common centre of mass d_c, xi = (spin of the base, joint rates), p_j the
linear momentum of a unit rate of joint j and m the total mass,

    u = v + R (xi_w x d_c + sum_j p_j xi_j / m)

decouples from xi: M becomes diag(m 1, S(joints)), where S has 3 + n_j rows and does not depend on the
base's pose. It comes from composite bodies and the bias from a recursion outwards and inwards
(Featherstone, "Rigid Body Dynamics Algorithms", 2008, ch. 5 and 6). A contact's row in direction a
(base axes) at the place r is (a, tau), tau_w = (r - d_c) x a, tau_j = a . (z_j x (r - k_j) - p_j / m).

A view costs 20 ns in Numba, so each body's vectors are columns of one array P, by name.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tossid.kernels import fused_inlined_kernel, kernel
from tossid.physics.cholesky import back_substitute, cholesky, forward_substitute
from tossid.rotations import quat_to_matrix

if TYPE_CHECKING:
    from tossid.physics.system import System

Array = NDArray[np.float64]

HINGE = 1
"""`JointType.HINGE`, as a constant that Numba can fold."""

# columns of P (n_b, WIDTH), each a vector of three (base axes, from the base's origin) unless said
X, AXIS, ANCHOR, SPIN, ALPHA, ACCEL = 0, 3, 6, 9, 12, 15  # origin; joint; spin; accelerations at dv/dt = 0
MASS, MOMENT, INERTIA = 18, 19, 22  # of the body and all beyond it: 1; first moment; xx, yy, zz, xy, xz, yz
FORCE, TORQUE, MOMENTUM = 28, 31, 34  # of the bias, all beyond; p_j / m
WIDTH = 37
"""Columns in all."""


class Articulated(NamedTuple):
    """What the kernels read of a tree, as plain arrays; shapes as in `System`.

    Attributes:
        parent: (n_b,) of each body.
        joint_type: (n_b,).
        turn: (n_b, 3, 3) rotation of each body's axes in its parent's at joint position 0.
        place: (n_b, 3) of each body's origin in its parent's axes [m].
        axis: (n_b, 3) of each joint, in its body's axes.
        anchor: (n_b, 3) of each joint, in its body's axes [m].
        mass: (n_b,) [kg].
        com: (n_b, 3) centre of mass in the body's axes [m].
        inertia: (n_b, 3, 3) about the centre of mass [kg m²].
    """

    parent: NDArray[np.int64]
    joint_type: NDArray[np.int64]
    turn: Array
    place: Array
    axis: Array
    anchor: Array
    mass: Array
    com: Array
    inertia: Array


def make_articulated(system: System) -> Articulated:
    """A system's tree as the kernels read it, in arrays of their own.

    Args:
        system: the simulator's parameters.
    """
    return Articulated(
        parent=np.array(system.parent),
        joint_type=np.array(system.joint_type),
        turn=np.ascontiguousarray(quat_to_matrix(system.body_quat)),
        place=np.array(system.body_pos),
        axis=np.array(system.joint_axis),
        anchor=np.array(system.joint_pos),
        mass=np.array(system.mass),
        com=np.array(system.com),
        inertia=np.array(system.inertia),
    )


@fused_inlined_kernel
def cross(a0, a1, a2, b0, b1, b2):  # type: ignore[no-untyped-def]
    """The cross product a x b."""
    return a1 * b2 - a2 * b1, a2 * b0 - a0 * b2, a0 * b1 - a1 * b0


@fused_inlined_kernel
def rotated(E, b, x0, x1, x2):  # type: ignore[no-untyped-def]
    """The vector E[b] x: from body b's axes to the base's."""
    return (
        E[b, 0, 0] * x0 + E[b, 0, 1] * x1 + E[b, 0, 2] * x2,
        E[b, 1, 0] * x0 + E[b, 1, 1] * x1 + E[b, 1, 2] * x2,
        E[b, 2, 0] * x0 + E[b, 2, 1] * x1 + E[b, 2, 2] * x2,
    )


@fused_inlined_kernel
def turning_acceleration(al0, al1, al2, w0, w1, w2, r0, r1, r2):  # type: ignore[no-untyped-def]
    """The acceleration alpha x r + w x (w x r) of a point at r from the origin of what turns."""
    t0, t1, t2 = cross(w0, w1, w2, r0, r1, r2)
    s0, s1, s2 = cross(w0, w1, w2, t0, t1, t2)
    t0, t1, t2 = cross(al0, al1, al2, r0, r1, r2)
    return s0 + t0, s1 + t1, s2 + t2


@fused_inlined_kernel
def outward_pass(tree, q, v, P, E):  # type: ignore[no-untyped-def]
    """Poses, spins and the accelerations that remain at dv/dt = 0, for q (nq,), v (nv,)."""
    parent, joint_type, turn, place, axis, anchor = (
        tree.parent, tree.joint_type, tree.turn, tree.place, tree.axis, tree.anchor
    )  # fmt: skip
    for i in range(3):
        P[0, SPIN + i] = v[3 + i]
        P[0, X + i], P[0, ALPHA + i], P[0, ACCEL + i] = 0.0, 0.0, 0.0
        for j in range(3):
            E[0, i, j] = 1.0 if i == j else 0.0
    for b in range(1, parent.shape[0]):
        up, angle, rate, hinge = parent[b], q[6 + b], v[5 + b], joint_type[b] == HINGE
        for i in range(3):
            for j in range(3):
                E[b, i, j] = E[up, i, 0] * turn[b, 0, j] + E[up, i, 1] * turn[b, 1, j] + E[up, i, 2] * turn[b, 2, j]
        a0, a1, a2 = axis[b, 0], axis[b, 1], axis[b, 2]
        z0, z1, z2 = rotated(E, b, a0, a1, a2)
        P[b, AXIS], P[b, AXIS + 1], P[b, AXIS + 2] = z0, z1, z2
        x0, x1, x2 = rotated(E, up, place[b, 0], place[b, 1], place[b, 2])
        x0, x1, x2 = x0 + P[up, X], x1 + P[up, X + 1], x2 + P[up, X + 2]
        o0, o1, o2 = rotated(E, b, anchor[b, 0], anchor[b, 1], anchor[b, 2])
        k0, k1, k2 = x0 + o0, x1 + o1, x2 + o2
        if hinge:
            c, s = math.cos(angle), math.sin(angle)
            for i in range(3):  # a row e of E times Rodrigues' rotation: c e + s (e x a) + (1 - c) (e . a) a
                e0, e1, e2 = E[b, i, 0], E[b, i, 1], E[b, i, 2]
                part = (1.0 - c) * P[b, AXIS + i]
                t0, t1, t2 = cross(e0, e1, e2, a0, a1, a2)
                E[b, i, 0], E[b, i, 1] = c * e0 + s * t0 + part * a0, c * e1 + s * t1 + part * a1
                E[b, i, 2] = c * e2 + s * t2 + part * a2
            o0, o1, o2 = rotated(E, b, anchor[b, 0], anchor[b, 1], anchor[b, 2])
        else:
            k0, k1, k2 = k0 + angle * z0, k1 + angle * z1, k2 + angle * z2
        P[b, ANCHOR], P[b, ANCHOR + 1], P[b, ANCHOR + 2] = k0, k1, k2
        P[b, X], P[b, X + 1], P[b, X + 2] = k0 - o0, k1 - o1, k2 - o2

        w0, w1, w2 = P[up, SPIN], P[up, SPIN + 1], P[up, SPIN + 2]
        l0, l1, l2 = P[up, ALPHA], P[up, ALPHA + 1], P[up, ALPHA + 2]
        s0, s1, s2 = turning_acceleration(l0, l1, l2, w0, w1, w2, k0 - P[up, X], k1 - P[up, X + 1], k2 - P[up, X + 2])
        g0, g1, g2 = P[up, ACCEL] + s0, P[up, ACCEL + 1] + s1, P[up, ACCEL + 2] + s2
        t0, t1, t2 = cross(w0, w1, w2, rate * z0, rate * z1, rate * z2)
        if hinge:
            l0, l1, l2 = l0 + t0, l1 + t1, l2 + t2
            w0, w1, w2 = w0 + rate * z0, w1 + rate * z1, w2 + rate * z2
        else:
            g0, g1, g2 = g0 + 2.0 * t0, g1 + 2.0 * t1, g2 + 2.0 * t2
        s0, s1, s2 = turning_acceleration(l0, l1, l2, w0, w1, w2, -o0, -o1, -o2)
        P[b, SPIN], P[b, SPIN + 1], P[b, SPIN + 2] = w0, w1, w2
        P[b, ALPHA], P[b, ALPHA + 1], P[b, ALPHA + 2] = l0, l1, l2
        P[b, ACCEL], P[b, ACCEL + 1], P[b, ACCEL + 2] = g0 + s0, g1 + s1, g2 + s2


@kernel
def outward_passes(tree, q, v, P, E):  # type: ignore[no-untyped-def]
    """`outward_pass` of each state, into P (B, n_b, WIDTH) and E (B, n_b, 3, 3)."""
    for n in range(len(q)):
        outward_pass(tree, q[n], v[n], P[n], E[n])


@fused_inlined_kernel
def own_inertia_and_bias(tree, P, E):  # type: ignore[no-untyped-def]
    """Mass, moments and bias of each body by itself. After `outward_pass`."""
    mass, com, inertia = tree.mass, tree.com, tree.inertia
    nb = tree.parent.shape[0]
    for b in range(nb):
        m = mass[b]
        c0, c1, c2 = rotated(E, b, com[b, 0], com[b, 1], com[b, 2])
        d0, d1, d2 = P[b, X] + c0, P[b, X + 1] + c1, P[b, X + 2] + c2
        w0, w1, w2 = P[b, SPIN], P[b, SPIN + 1], P[b, SPIN + 2]
        l0, l1, l2 = P[b, ALPHA], P[b, ALPHA + 1], P[b, ALPHA + 2]
        s0, s1, s2 = turning_acceleration(l0, l1, l2, w0, w1, w2, c0, c1, c2)
        f0, f1, f2 = m * (P[b, ACCEL] + s0), m * (P[b, ACCEL + 1] + s1), m * (P[b, ACCEL + 2] + s2)
        # E I E^T, by its columns' products
        y00, y10, y20 = rotated(E, b, inertia[b, 0, 0], inertia[b, 1, 0], inertia[b, 2, 0])
        y01, y11, y21 = rotated(E, b, inertia[b, 0, 1], inertia[b, 1, 1], inertia[b, 2, 1])
        y02, y12, y22 = rotated(E, b, inertia[b, 0, 2], inertia[b, 1, 2], inertia[b, 2, 2])
        xx, xy, xz = rotated(E, b, y00, y01, y02)
        _, yy, yz = rotated(E, b, y10, y11, y12)
        zz = E[b, 2, 0] * y20 + E[b, 2, 1] * y21 + E[b, 2, 2] * y22
        h0, h1, h2 = xx * w0 + xy * w1 + xz * w2, xy * w0 + yy * w1 + yz * w2, xz * w0 + yz * w1 + zz * w2
        n0, n1, n2 = cross(w0, w1, w2, h0, h1, h2)
        t0, t1, t2 = cross(d0, d1, d2, f0, f1, f2)
        P[b, TORQUE] = t0 + n0 + xx * l0 + xy * l1 + xz * l2
        P[b, TORQUE + 1] = t1 + n1 + xy * l0 + yy * l1 + yz * l2
        P[b, TORQUE + 2] = t2 + n2 + xz * l0 + yz * l1 + zz * l2
        P[b, FORCE], P[b, FORCE + 1], P[b, FORCE + 2] = f0, f1, f2
        P[b, MASS], P[b, MOMENT], P[b, MOMENT + 1], P[b, MOMENT + 2] = m, m * d0, m * d1, m * d2
        P[b, INERTIA] = xx + m * (d1 * d1 + d2 * d2)
        P[b, INERTIA + 1] = yy + m * (d0 * d0 + d2 * d2)
        P[b, INERTIA + 2] = zz + m * (d0 * d0 + d1 * d1)
        P[b, INERTIA + 3], P[b, INERTIA + 4] = xy - m * d0 * d1, xz - m * d0 * d2
        P[b, INERTIA + 5] = yz - m * d1 * d2


@fused_inlined_kernel
def inward_pass(parent, P):  # type: ignore[no-untyped-def]
    """Mass, moments and bias of each body with all beyond it. After `own_inertia_and_bias`."""
    for b in range(parent.shape[0] - 1, 0, -1):
        up = parent[b]
        for i in range(MASS, MOMENTUM):
            P[up, i] += P[b, i]


@fused_inlined_kernel
def factorise(parent, joint_type, torque, slack, P, L, rate):  # type: ignore[no-untyped-def]
    """Lower Cholesky factor of S into L, with its diagonal's inverse; rate (3 + n_j,) = S^-1 (torque - bias).

    torque (n_b,) of the joints, 0 for the base; slack (n_b,) is added to S's diagonal. After `inward_pass`.

    Returns whether S and m are positive.
    """
    nb, m = parent.shape[0], P[0, MASS]
    if not m > 0.0:
        return False
    part = 1.0 / m
    d0, d1, d2 = part * P[0, MOMENT], part * P[0, MOMENT + 1], part * P[0, MOMENT + 2]
    g0, g1, g2 = P[0, FORCE], P[0, FORCE + 1], P[0, FORCE + 2]
    t0, t1, t2 = cross(d0, d1, d2, g0, g1, g2)
    rate[0], rate[1], rate[2] = t0 - P[0, TORQUE], t1 - P[0, TORQUE + 1], t2 - P[0, TORQUE + 2]
    L[0, 0] = P[0, INERTIA] - m * (d1 * d1 + d2 * d2)
    L[1, 1] = P[0, INERTIA + 1] - m * (d0 * d0 + d2 * d2)
    L[2, 2] = P[0, INERTIA + 2] - m * (d0 * d0 + d1 * d1)
    L[1, 0], L[2, 0] = P[0, INERTIA + 3] + m * d0 * d1, P[0, INERTIA + 4] + m * d0 * d2
    L[2, 1] = P[0, INERTIA + 5] + m * d1 * d2
    for b in range(1, nb):
        row = 2 + b
        z0, z1, z2 = P[b, AXIS], P[b, AXIS + 1], P[b, AXIS + 2]
        k0, k1, k2 = P[b, ANCHOR], P[b, ANCHOR + 1], P[b, ANCHOR + 2]
        s0, s1, s2 = P[b, MOMENT], P[b, MOMENT + 1], P[b, MOMENT + 2]
        f0, f1, f2 = P[b, FORCE], P[b, FORCE + 1], P[b, FORCE + 2]
        # momentum p and angular momentum h (about the base's origin) of a unit rate
        if joint_type[b] == HINGE:
            mb = P[b, MASS]
            p0, p1, p2 = cross(z0, z1, z2, s0 - mb * k0, s1 - mb * k1, s2 - mb * k2)
            t0, t1, t2 = cross(k0, k1, k2, z0, z1, z2)
            h0, h1, h2 = cross(s0, s1, s2, t0, t1, t2)
            h0 += P[b, INERTIA] * z0 + P[b, INERTIA + 3] * z1 + P[b, INERTIA + 4] * z2
            h1 += P[b, INERTIA + 3] * z0 + P[b, INERTIA + 1] * z1 + P[b, INERTIA + 5] * z2
            h2 += P[b, INERTIA + 4] * z0 + P[b, INERTIA + 5] * z1 + P[b, INERTIA + 2] * z2
            t0, t1, t2 = cross(k0, k1, k2, f0, f1, f2)
            bias = z0 * (P[b, TORQUE] - t0) + z1 * (P[b, TORQUE + 1] - t1) + z2 * (P[b, TORQUE + 2] - t2)
        else:
            p0, p1, p2 = P[b, MASS] * z0, P[b, MASS] * z1, P[b, MASS] * z2
            h0, h1, h2 = cross(s0, s1, s2, z0, z1, z2)
            bias = z0 * f0 + z1 * f1 + z2 * f2
        P[b, MOMENTUM], P[b, MOMENTUM + 1], P[b, MOMENTUM + 2] = part * p0, part * p1, part * p2
        rate[row] = part * (p0 * g0 + p1 * g1 + p2 * g2) - bias + torque[b]
        t0, t1, t2 = cross(d0, d1, d2, p0, p1, p2)
        L[row, 0], L[row, 1], L[row, 2] = h0 - t0, h1 - t1, h2 - t2
        for i in range(1, b + 1):
            L[row, 2 + i] = -(p0 * P[i, MOMENTUM] + p1 * P[i, MOMENTUM + 1] + p2 * P[i, MOMENTUM + 2])
        i = b
        while i > 0:
            if joint_type[i] == HINGE:
                t0, t1, t2 = cross(P[i, ANCHOR], P[i, ANCHOR + 1], P[i, ANCHOR + 2], p0, p1, p2)
                t0, t1, t2 = h0 - t0, h1 - t1, h2 - t2
            else:
                t0, t1, t2 = p0, p1, p2
            L[row, 2 + i] += P[i, AXIS] * t0 + P[i, AXIS + 1] * t1 + P[i, AXIS + 2] * t2
            i = parent[i]
        L[row, row] += slack[b]
    nx = 2 + nb
    if not cholesky(L, nx):
        return False
    forward_substitute(L, rate, nx)
    back_substitute(L, rate, nx)
    return True


@fused_inlined_kernel
def common_velocity(P, xi, first):  # type: ignore[no-untyped-def]
    """Velocity of the common centre of mass from the base's origin's, base axes: xi_w x d_c + sum_j p_j xi_j / m.

    xi starts at xi[first].
    """
    part = 1.0 / P[0, MASS]
    x0, x1, x2 = cross(
        xi[first], xi[first + 1], xi[first + 2], part * P[0, MOMENT], part * P[0, MOMENT + 1], part * P[0, MOMENT + 2]
    )
    for b in range(1, P.shape[0]):
        r = xi[first + 2 + b]
        x0, x1, x2 = x0 + r * P[b, MOMENTUM], x1 + r * P[b, MOMENTUM + 1], x2 + r * P[b, MOMENTUM + 2]
    return x0, x1, x2


@fused_inlined_kernel
def contact_row(tree, P, body, place, R, tau, c, k):  # type: ignore[no-untyped-def]
    """tau[c, k] (n_x,) of corner c of `body` at place[c], along direction k of (z, x, y). After `factorise`.

    tau_w = (r - d_c) x a, tau_j = a . (z_j x (r - k_j) - p_j / m).
    """
    i, part = k - 1 if k else 2, 1.0 / P[0, MASS]
    a0, a1, a2 = R[i, 0], R[i, 1], R[i, 2]
    r0, r1, r2 = place[c, 0], place[c, 1], place[c, 2]
    tau[c, k, 0], tau[c, k, 1], tau[c, k, 2] = cross(
        r0 - part * P[0, MOMENT], r1 - part * P[0, MOMENT + 1], r2 - part * P[0, MOMENT + 2], a0, a1, a2
    )
    for b in range(1, tree.parent.shape[0]):
        tau[c, k, 2 + b] = -(a0 * P[b, MOMENTUM] + a1 * P[b, MOMENTUM + 1] + a2 * P[b, MOMENTUM + 2])
    b = body
    while b > 0:
        z0, z1, z2 = P[b, AXIS], P[b, AXIS + 1], P[b, AXIS + 2]
        if tree.joint_type[b] == HINGE:
            z0, z1, z2 = cross(z0, z1, z2, r0 - P[b, ANCHOR], r1 - P[b, ANCHOR + 1], r2 - P[b, ANCHOR + 2])
        tau[c, k, 2 + b] += a0 * z0 + a1 * z1 + a2 * z2
        b = tree.parent[b]


@fused_inlined_kernel
def spin_row(tree, P, body, a0, a1, a2, row):  # type: ignore[no-untyped-def]
    """row (n_x,) with row . xi the spin of `body` about the direction a (base axes). After `outward_pass`."""
    for x in range(row.shape[0]):
        row[x] = 0.0
    row[0], row[1], row[2] = a0, a1, a2
    b = body
    while b > 0:
        if tree.joint_type[b] == HINGE:
            row[2 + b] = a0 * P[b, AXIS] + a1 * P[b, AXIS + 1] + a2 * P[b, AXIS + 2]
        b = tree.parent[b]
