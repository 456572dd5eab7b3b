"""One transition's dynamics as the implicit loss needs them: M, k and twists of a tree (Numba).

All of it is linear in the bodies' mass, moment and inertia, given the motion (`Transitions`).
A transition is copied to scratch first, where each body's numbers are columns of one array
and each matrix and vector of the size of v is a row of another: arrays as arguments cost
time, to the compiler above all.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tossid.kernels import fused_kernel

Array = NDArray[np.float64]

# The names of columns and rows are int64, not int, as Numba compiles a function anew for every int that it is given.
_P = np.array([0, 9, 12, 15, 18, 21, 22, 28, 34, 40, 46, 59, 72])
_Q = np.array([0, 3, 6, 8, 9, 10, 11])
_ROWS = np.arange(5)
# Columns of P (n_b, WIDTH). In body axes: rotation, spin, its derivative, acceleration less gravity, vertical and
# height after the step. In world axes (angular, linear): twists of v', of M^-1 W residual before impulses, and of z;
# wrench. Mass, moment and inertia: the model's and the metric's.
TURN, SPIN, ALPHA, ACCEL, UP, HEIGHT, NEXT, FREE, TEST, WRENCH, BODY, METRIC, WIDTH = _P
# Columns of Q (n_c, DEPTH): place in body and in world axes, sliding velocity, its length, phi', and gap / dt.
POS, PLACE, SLIDE, SPEED, PHI, GAP, DEPTH = _Q
# G (5, nv, nv): M, its factor, W, C = (M^-1 F)^T with W = F F^T, and S X of one body (six rows).
MASS, FACTOR, WEIGHT, HALF, SPATIAL = _ROWS
# U (5, nv): M^-1 k, M^-1 J^T lam, residual, y = W residual (over m), z = M^-1 y.
A0, PUSH, RESIDUAL, Y, Z = _ROWS
BASE = np.int64(0)


class Kinematics(NamedTuple):
    """What the kernels read of `Transitions`, as arrays; near (N,) says whether contact is possible."""

    dt: Array
    v_next: Array
    dv: Array
    X: Array
    omega: Array
    alpha: Array
    xdd: Array
    R: Array
    up_next: Array
    z_next: Array
    near: NDArray[np.bool_]


class Work(NamedTuple):
    """Scratch of one transition, and the model's numbers in columns BODY, METRIC and POS.

    X (n_b, 6, nv). XC (n_b, 6, nv) = X C^T in world axes, H (nv, 3 n_c) with H^T H the inner problem's matrix.
    """

    P: Array
    Q: Array
    G: Array
    U: Array
    X: Array
    XC: Array
    H: Array


def make_work(body: Array, metric: Array, corner_pos: Array) -> Work:
    """Scratch for bodies (n_b, 13: mass, moment, inertia), their given values, and corners (n_c, 3)."""
    n_bodies, n_corners = len(body), len(corner_pos)
    nv = 5 + n_bodies
    P, Q = np.zeros((n_bodies, WIDTH)), np.zeros((n_corners, DEPTH))
    P[:, BODY:METRIC], P[:, METRIC:], Q[:, POS:PLACE] = body, metric, corner_pos
    X, XC, H = np.zeros((n_bodies, 6, nv)), np.zeros((n_bodies, 6, nv)), np.zeros((nv, 3 * n_corners))
    return Work(P, Q, np.zeros((5, nv, nv)), np.zeros((5, nv)), X, XC, H)


@fused_kernel
def cross(a, b):  # type: ignore[no-untyped-def]
    """Cross product a x b of three numbers each."""
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@fused_kernel
def dot(a, b):  # type: ignore[no-untyped-def]
    """Scalar product a . b of three numbers each."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@fused_kernel
def get(P, b, at):  # type: ignore[no-untyped-def]
    """The three numbers P[b, at : at + 3]."""
    return P[b, at], P[b, at + 1], P[b, at + 2]


@fused_kernel
def put(P, b, at, x):  # type: ignore[no-untyped-def]
    """P[b, at : at + 3] = x."""
    P[b, at], P[b, at + 1], P[b, at + 2] = x


@fused_kernel
def product(P, b, at, x):  # type: ignore[no-untyped-def]
    """A x for the 3x3 matrix A at P[b, at : at + 9]; with TURN, from body to world axes."""
    return dot(get(P, b, at), x), dot(get(P, b, at + 3), x), dot(get(P, b, at + 6), x)


@fused_kernel
def to_body(P, b, x):  # type: ignore[no-untyped-def]
    """A vector x from world to body axes."""
    return (
        P[b, TURN] * x[0] + P[b, TURN + 3] * x[1] + P[b, TURN + 6] * x[2],
        P[b, TURN + 1] * x[0] + P[b, TURN + 4] * x[1] + P[b, TURN + 7] * x[2],
        P[b, TURN + 2] * x[0] + P[b, TURN + 5] * x[1] + P[b, TURN + 8] * x[2],
    )


@fused_kernel
def load(kin, n, gravity, P, X):  # type: ignore[no-untyped-def]
    """Transition n into X and the first columns of P."""
    g = (gravity[0], gravity[1], gravity[2])
    for b in range(len(P)):
        for i in range(3):
            for j in range(3):
                P[b, TURN + 3 * i + j] = kin.R[n, b, i, j]
        down = to_body(P, b, g)
        for i in range(3):
            P[b, SPIN + i] = kin.omega[n, b, i]
            P[b, ALPHA + i] = kin.alpha[n, b, i]
            P[b, ACCEL + i] = kin.xdd[n, b, i] - down[i]
            P[b, UP + i] = kin.up_next[n, b, i]
        P[b, HEIGHT] = kin.z_next[n, b]
        for i in range(6):
            for j in range(X.shape[2]):
                X[b, i, j] = kin.X[n, b, i, j]


@fused_kernel
def body_twist(X, b, U, row):  # type: ignore[no-untyped-def]
    """X[b] x for x = U[row], as angular and linear part (body axes)."""
    w0, w1, w2, u0, u1, u2 = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for j in range(X.shape[2]):
        x = U[row, j]
        w0 += X[b, 0, j] * x
        w1 += X[b, 1, j] * x
        w2 += X[b, 2, j] * x
        u0 += X[b, 3, j] * x
        u1 += X[b, 4, j] * x
        u2 += X[b, 5, j] * x
    return (w0, w1, w2), (u0, u1, u2)


@fused_kernel
def world_twists(P, X, U, row, at):  # type: ignore[no-untyped-def]
    """P[b, at : at + 6] = X[b] x in world axes for x = U[row] and every body."""
    for b in range(len(P)):
        w, u = body_twist(X, b, U, row)
        put(P, b, at, product(P, b, TURN, w))
        put(P, b, at + 3, product(P, b, TURN, u))


@fused_kernel
def add_wrench(X, b, torque, force, U, row):  # type: ignore[no-untyped-def]
    """U[row] += X[b]^T (torque, force), body axes."""
    for j in range(X.shape[2]):
        U[row, j] += (
            X[b, 0, j] * torque[0]
            + X[b, 1, j] * torque[1]
            + X[b, 2, j] * torque[2]
            + X[b, 3, j] * force[0]
            + X[b, 4, j] * force[1]
            + X[b, 5, j] * force[2]
        )


@fused_kernel
def mass_matrix(P, at, X, G, row):  # type: ignore[no-untyped-def]
    """G[row] = sum over bodies of X^T [[inertia, h^], [-h^, mass]] X, lower triangle; numbers in column `at` of P."""
    nv = X.shape[2]
    for b in range(len(P)):
        m, h = P[b, at], get(P, b, at + 1)
        for j in range(nv):
            w, u = (X[b, 0, j], X[b, 1, j], X[b, 2, j]), (X[b, 3, j], X[b, 4, j], X[b, 5, j])
            Iw, hu, hw = product(P, b, at + 4, w), cross(h, u), cross(h, w)
            for i in range(3):
                G[SPATIAL, i, j] = Iw[i] + hu[i]
                G[SPATIAL, 3 + i, j] = m * u[i] - hw[i]
        for i in range(nv):
            for j in range(i + 1):
                value = 0.0 if b == 0 else G[row, i, j]
                for k in range(6):
                    value += X[b, k, i] * G[SPATIAL, k, j]
                G[row, i, j] = value


@fused_kernel
def factor(G, row, into):  # type: ignore[no-untyped-def]
    """Cholesky factor of G[row] into G[into], its diagonal inverted; NaN if G[row] is not positive definite."""
    nv = G.shape[1]
    for j in range(nv):
        pivot = G[row, j, j]
        for k in range(j):
            pivot -= G[into, j, k] * G[into, j, k]
        inverse = 1.0 / math.sqrt(pivot) if pivot > 0.0 else math.nan
        G[into, j, j] = inverse
        for i in range(j + 1, nv):
            value = G[row, i, j]
            for k in range(j):
                value -= G[into, i, k] * G[into, j, k]
            G[into, i, j] = value * inverse


@fused_kernel
def solve(G, U, row):  # type: ignore[no-untyped-def]
    """U[row] <- M^-1 U[row]."""
    nv = U.shape[1]
    for i in range(nv):
        value = U[row, i]
        for k in range(i):
            value -= G[FACTOR, i, k] * U[row, k]
        U[row, i] = value * G[FACTOR, i, i]
    for i in range(nv - 1, -1, -1):
        value = U[row, i]
        for k in range(i + 1, nv):
            value -= G[FACTOR, k, i] * U[row, k]
        U[row, i] = value * G[FACTOR, i, i]


@fused_kernel
def half_response(G):  # type: ignore[no-untyped-def]
    """G[HALF] = C^T = M^-1 F, where W = F F^T."""
    nv = G.shape[1]
    factor(G, WEIGHT, HALF)
    for i in range(nv):
        G[HALF, i, i] = 1.0 / G[HALF, i, i]
        for j in range(i + 1, nv):
            G[HALF, i, j] = 0.0
    for i in range(nv):
        for k in range(i):
            for j in range(nv):
                G[HALF, i, j] -= G[FACTOR, i, k] * G[HALF, k, j]
        for j in range(nv):
            G[HALF, i, j] *= G[FACTOR, i, i]
    for i in range(nv - 1, -1, -1):
        for k in range(i + 1, nv):
            for j in range(nv):
                G[HALF, i, j] -= G[FACTOR, k, i] * G[HALF, k, j]
        for j in range(nv):
            G[HALF, i, j] *= G[FACTOR, i, i]


@fused_kernel
def weigh(G, U):  # type: ignore[no-untyped-def]
    """U[Y] = W U[RESIDUAL]."""
    for i in range(U.shape[1]):
        x = U[RESIDUAL, i]
        value = G[WEIGHT, i, i] * x
        for j in range(i):
            value += G[WEIGHT, i, j] * U[RESIDUAL, j]
            U[Y, j] += G[WEIGHT, i, j] * x
        U[Y, i] = value


@fused_kernel
def free_motion(P, X, G, U):  # type: ignore[no-untyped-def]
    """M, its factor, and U[A0] = M^-1 k: gravity less Coriolis, centrifugal and gyroscopic forces (Newton-Euler)."""
    mass_matrix(P, BODY, X, G, MASS)
    factor(G, MASS, FACTOR)
    for j in range(U.shape[1]):
        U[A0, j] = 0.0
    for b in range(len(P)):
        m, h, w, alpha, acc = P[b, BODY], get(P, b, BODY + 1), get(P, b, SPIN), get(P, b, ALPHA), get(P, b, ACCEL)
        Ia, wIw, hacc = product(P, b, BODY + 4, alpha), cross(w, product(P, b, BODY + 4, w)), cross(h, acc)
        ah, wwh = cross(alpha, h), cross(w, cross(w, h))
        angular = (-Ia[0] - wIw[0] - hacc[0], -Ia[1] - wIw[1] - hacc[1], -Ia[2] - wIw[2] - hacc[2])
        linear = (-m * acc[0] - ah[0] - wwh[0], -m * acc[1] - ah[1] - wwh[1], -m * acc[2] - ah[2] - wwh[2])
        add_wrench(X, b, angular, linear, U, A0)
    solve(G, U, A0)


@fused_kernel
def add_a_res(P, a_res, n, out, row, scale):  # type: ignore[no-untyped-def]
    """out[row] += scale a_res, from the base's axes to the order of v."""
    if len(a_res):
        turned = product(P, BASE, TURN, get(a_res, n, BASE))
        for j in range(a_res.shape[1]):
            out[row, j] += scale * (turned[j] if j < 3 else a_res[n, j])


@fused_kernel
def accelerations(kin, gravity, a_res, work, out):  # type: ignore[no-untyped-def]
    """The free acceleration M^-1 k + a_res into out (N, nv)."""
    for n in range(len(out)):
        load(kin, n, gravity, work.P, work.X)
        free_motion(work.P, work.X, work.G, work.U)
        for j in range(out.shape[1]):
            out[n, j] = work.U[A0, j]
        add_a_res(work.P, a_res, n, out, n, 1.0)
