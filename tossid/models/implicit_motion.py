"""One transition's dynamics as the implicit loss needs them: M, k and twists of a tree (Numba).

All of it is linear in the bodies' mass, moment and inertia, given the motion (`Transitions`).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numba
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

jit = numba.njit(cache=True, error_model="numpy", nogil=True, fastmath={"contract"})


class Motion(NamedTuple):
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


class Bodies(NamedTuple):
    """mass (n_b,), moment (n_b, 3), inertia (n_b, 3, 3) about the bodies' origins."""

    mass: Array
    moment: Array
    inertia: Array


class Work(NamedTuple):
    """Scratch of one transition.

    S (6, nv), M, L (the factor of M), W, C = (M^-1 F)^T with W = F F^T, (nv, nv); Y (n_b, 6, nv) = X C^T in world
    axes; H (nv, 3 n_c) with H^T H the inner problem's matrix. a0, push, miss, y, z (nv,). twist (3, n_b, 6) of
    v', M^-1 W miss before impulses and z, wrench (n_b, 6): angular, then linear, world axes.
    r, slide (n_c, 3): place from the body's origin, and (sliding velocity, its length); phi, gap (n_c,).
    """

    S: Array
    M: Array
    L: Array
    W: Array
    C: Array
    Y: Array
    H: Array
    a0: Array
    push: Array
    miss: Array
    y: Array
    z: Array
    twist: Array
    wrench: Array
    r: Array
    slide: Array
    phi: Array
    gap: Array


def make_work(n_bodies: int, nv: int, n_corners: int) -> Work:
    """Scratch for the kernels."""
    square, vector = (nv, nv), (nv,)
    shapes: list[tuple[int, ...]] = [(6, nv), square, square, square, square, (n_bodies, 6, nv), (nv, 3 * n_corners)]
    shapes += [vector] * 5 + [(3, n_bodies, 6), (n_bodies, 6), (n_corners, 3), (n_corners, 3)] + [(n_corners,)] * 2
    return Work(*(np.zeros(shape) for shape in shapes))


@jit
def cross(a, b):  # type: ignore[no-untyped-def]
    """a x b of three numbers each."""
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@jit
def dot(a, b):  # type: ignore[no-untyped-def]
    """a . b of three numbers each."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@jit
def to_world(R, n, b, x):  # type: ignore[no-untyped-def]
    """R[n, b] x."""
    return (
        R[n, b, 0, 0] * x[0] + R[n, b, 0, 1] * x[1] + R[n, b, 0, 2] * x[2],
        R[n, b, 1, 0] * x[0] + R[n, b, 1, 1] * x[1] + R[n, b, 1, 2] * x[2],
        R[n, b, 2, 0] * x[0] + R[n, b, 2, 1] * x[1] + R[n, b, 2, 2] * x[2],
    )


@jit
def to_body(R, n, b, x):  # type: ignore[no-untyped-def]
    """R[n, b]^T x."""
    return (
        R[n, b, 0, 0] * x[0] + R[n, b, 1, 0] * x[1] + R[n, b, 2, 0] * x[2],
        R[n, b, 0, 1] * x[0] + R[n, b, 1, 1] * x[1] + R[n, b, 2, 1] * x[2],
        R[n, b, 0, 2] * x[0] + R[n, b, 1, 2] * x[1] + R[n, b, 2, 2] * x[2],
    )


@jit
def body_twist(X, n, b, x):  # type: ignore[no-untyped-def]
    """X[n, b] x, as angular and linear part (body axes)."""
    w0, w1, w2, u0, u1, u2 = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for j in range(X.shape[3]):
        w0 += X[n, b, 0, j] * x[j]
        w1 += X[n, b, 1, j] * x[j]
        w2 += X[n, b, 2, j] * x[j]
        u0 += X[n, b, 3, j] * x[j]
        u1 += X[n, b, 4, j] * x[j]
        u2 += X[n, b, 5, j] * x[j]
    return (w0, w1, w2), (u0, u1, u2)


@jit
def world_twists(X, R, n, x, twist, which):  # type: ignore[no-untyped-def]
    """twist[which, b] = X[n, b] x in world axes, for every body."""
    for b in range(X.shape[1]):
        w, u = body_twist(X, n, b, x)
        w, u = to_world(R, n, b, w), to_world(R, n, b, u)
        for i in range(3):
            twist[which, b, i], twist[which, b, 3 + i] = w[i], u[i]


@jit
def add_wrench(X, n, b, torque, force, out):  # type: ignore[no-untyped-def]
    """out (nv,) += X[n, b]^T (torque, force), body axes."""
    for j in range(X.shape[3]):
        out[j] += (
            X[n, b, 0, j] * torque[0]
            + X[n, b, 1, j] * torque[1]
            + X[n, b, 2, j] * torque[2]
            + X[n, b, 3, j] * force[0]
            + X[n, b, 4, j] * force[1]
            + X[n, b, 5, j] * force[2]
        )


@jit
def mass_matrix(X, n, bodies, S, M):  # type: ignore[no-untyped-def]
    """M (nv, nv) = sum over bodies of X^T [[inertia, h^], [-h^, mass]] X; lower triangle."""
    nv = X.shape[3]
    for b in range(X.shape[1]):
        m, I = bodies.mass[b], bodies.inertia
        h = (bodies.moment[b, 0], bodies.moment[b, 1], bodies.moment[b, 2])
        for j in range(nv):
            w = (X[n, b, 0, j], X[n, b, 1, j], X[n, b, 2, j])
            u = (X[n, b, 3, j], X[n, b, 4, j], X[n, b, 5, j])
            hu, hw = cross(h, u), cross(h, w)
            for i in range(3):
                S[i, j] = I[b, i, 0] * w[0] + I[b, i, 1] * w[1] + I[b, i, 2] * w[2] + hu[i]
                S[3 + i, j] = m * u[i] - hw[i]
        for i in range(nv):
            for j in range(i + 1):
                value = 0.0 if b == 0 else M[i, j]
                for k in range(6):
                    value += X[n, b, k, i] * S[k, j]
                M[i, j] = value


@jit
def factor(M, L):  # type: ignore[no-untyped-def]
    """Cholesky factor of M's lower triangle into L, its diagonal inverted; NaN if M is not positive definite."""
    for j in range(len(M)):
        pivot = M[j, j]
        for k in range(j):
            pivot -= L[j, k] * L[j, k]
        inverse = 1.0 / math.sqrt(pivot) if pivot > 0.0 else math.nan
        L[j, j] = inverse
        for i in range(j + 1, len(M)):
            value = M[i, j]
            for k in range(j):
                value -= L[i, k] * L[j, k]
            L[i, j] = value * inverse


@jit
def solve(L, x):  # type: ignore[no-untyped-def]
    """x (nv,) <- M^-1 x, with L of `factor`."""
    for i in range(len(x)):
        value = x[i]
        for k in range(i):
            value -= L[i, k] * x[k]
        x[i] = value * L[i, i]
    for i in range(len(x) - 1, -1, -1):
        value = x[i]
        for k in range(i + 1, len(x)):
            value -= L[k, i] * x[k]
        x[i] = value * L[i, i]


@jit
def solve_columns(L, C):  # type: ignore[no-untyped-def]
    """C (nv, nv) <- M^-1 C, with L of `factor`."""
    size = len(C)
    for i in range(size):
        for k in range(i):
            for j in range(size):
                C[i, j] -= L[i, k] * C[k, j]
        for j in range(size):
            C[i, j] *= L[i, i]
    for i in range(size - 1, -1, -1):
        for k in range(i + 1, size):
            for j in range(size):
                C[i, j] -= L[k, i] * C[k, j]
        for j in range(size):
            C[i, j] *= L[i, i]


@jit
def multiply_lower(W, x, out):  # type: ignore[no-untyped-def]
    """out = W x for W symmetric, of which the lower triangle is given."""
    for i in range(len(x)):
        value = W[i, i] * x[i]
        for j in range(i):
            value += W[i, j] * x[j]
            out[j] += W[i, j] * x[i]
        out[i] = value


@jit
def force(motion, n, bodies, gravity, k):  # type: ignore[no-untyped-def]
    """k(q, v) (nv,): gravity less Coriolis, centrifugal and gyroscopic forces (Newton-Euler)."""
    k[:] = 0.0
    for b in range(motion.X.shape[1]):
        m, h, acc, w, alpha = body_motion(motion, n, b, bodies, gravity)
        Iw, Ia = body_product(bodies.inertia, b, w), body_product(bodies.inertia, b, alpha)
        ah, wwh, wIw, hacc = cross(alpha, h), cross(w, cross(w, h)), cross(w, Iw), cross(h, acc)
        angular = (-Ia[0] - wIw[0] - hacc[0], -Ia[1] - wIw[1] - hacc[1], -Ia[2] - wIw[2] - hacc[2])
        linear = (-m * acc[0] - ah[0] - wwh[0], -m * acc[1] - ah[1] - wwh[1], -m * acc[2] - ah[2] - wwh[2])
        add_wrench(motion.X, n, b, angular, linear, k)


@jit
def body_motion(motion, n, b, bodies, gravity):  # type: ignore[no-untyped-def]
    """(mass, moment, the origin's acceleration less gravity, spin, its derivative) of a body, body axes."""
    g = to_body(motion.R, n, b, (gravity[0], gravity[1], gravity[2]))
    return (
        bodies.mass[b],
        (bodies.moment[b, 0], bodies.moment[b, 1], bodies.moment[b, 2]),
        (motion.xdd[n, b, 0] - g[0], motion.xdd[n, b, 1] - g[1], motion.xdd[n, b, 2] - g[2]),
        (motion.omega[n, b, 0], motion.omega[n, b, 1], motion.omega[n, b, 2]),
        (motion.alpha[n, b, 0], motion.alpha[n, b, 1], motion.alpha[n, b, 2]),
    )


@jit
def body_product(I, b, x):  # type: ignore[no-untyped-def]
    """I[b] x."""
    return (
        I[b, 0, 0] * x[0] + I[b, 0, 1] * x[1] + I[b, 0, 2] * x[2],
        I[b, 1, 0] * x[0] + I[b, 1, 1] * x[1] + I[b, 1, 2] * x[2],
        I[b, 2, 0] * x[0] + I[b, 2, 1] * x[1] + I[b, 2, 2] * x[2],
    )


@jit
def free_motion(motion, n, bodies, gravity, residual, work, out):  # type: ignore[no-untyped-def]
    """out = M^-1 k + a_res; leaves M, its factor and a_0 = M^-1 k in `work`."""
    mass_matrix(motion.X, n, bodies, work.S, work.M)
    factor(work.M, work.L)
    force(motion, n, bodies, gravity, work.a0)
    solve(work.L, work.a0)
    for j in range(len(out)):
        out[j] = work.a0[j]
    if len(residual):
        turned = to_world(motion.R, n, 0, (residual[n, 0], residual[n, 1], residual[n, 2]))
        for j in range(len(out)):
            out[j] += turned[j] if j < 3 else residual[n, j]


@jit
def accelerations(motion, bodies, gravity, residual, work, out):  # type: ignore[no-untyped-def]
    """out (N, nv) = M^-1 k + a_res."""
    for n in range(len(out)):
        free_motion(motion, n, bodies, gravity, residual, work, out[n])
