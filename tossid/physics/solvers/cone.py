"""The exact friction cone of one time step: non-penetration and maximum dissipation.

    0 <= lam_n  _|_  w_n >= 0,   lam_t = argmin over |lam_t| <= mu lam_n of lam_t . w_t,   w = A lam + b

(Moreau 1988; Stewart & Trinkle 1996 before the cone becomes a polyhedron.) The problem is not
convex. Two moves alternate:

1. a sweep of projected Gauss-Seidel, each contact solved exactly (`block_cone`);
2. a Newton step on the equations of the state that the sweep found (open: lam_i = 0;
   sticking: w_i = 0; slipping: w_n = 0 and u x w_t = 0 with lam_i = s (1, mu u)), taken if
   the KKT error falls. From a warm start it is tried first: a body that slides or rests on
   needs nothing else.

Where they stall, `exact_cone` solves the problem as a sequence of convex cone programmes.
"""

from __future__ import annotations

import math

import numpy as np

from tossid.kernels import fused_inlined_kernel, fused_lean_kernel
from tossid.physics.solvers.blocks import block_cone, cholesky_solve, lu_solve
from tossid.physics.solvers.workspace import (
    BASIS,
    KIND,
    LAM,
    MAX_ITERATIONS,
    MU,
    NOT_FINITE,
    OPEN,
    ROW,
    SCALE,
    SLIP,
    SOLVED,
    STICK,
    TOP,
    TRIAL,
    TRIAL_W,
    WIDTH,
    W,
    X,
    accept_trial,
    contact_scales,
    free_length,
    manifold_step,
    multiply,
    project_row,
    shift,
    velocity_without,
)

PROXIMAL_WEIGHT = 1e-10
"""Share by which the Newton matrix's diagonal is raised: a singular one becomes regular."""
QUICK = 0.1
"""A Newton step that lowers the KKT error to this share is followed by another, without a sweep."""


@fused_inlined_kernel
def cone_natural_map(V, lam, w, m):  # type: ignore[no-untyped-def]
    """The KKT error of the exact cone (`problem`) [m/s] at V[lam], V[w].

    The largest over contacts of |min(a lam_n, w_n)| and |a lam_t - P(a lam_t - w_t)|, P the projection on the disk of
    radius mu a max(lam_n, 0).
    """
    worst = 0.0
    for i in range(m):
        k = 3 * i
        a, normal = V[SCALE, i], V[lam, k]
        x1, x2 = a * V[lam, k + 1] - V[w, k + 1], a * V[lam, k + 2] - V[w, k + 2]
        radius, reach = V[MU, i] * a * max(normal, 0.0), x1 * x1 + x2 * x2
        if reach > radius * radius:
            part = radius / math.sqrt(reach)
            x1, x2 = part * x1, part * x2
        d1, d2 = a * V[lam, k + 1] - x1, a * V[lam, k + 2] - x2
        step = max(abs(min(a * normal, V[w, k])), math.sqrt(d1 * d1 + d2 * d2))
        if not step <= worst:
            worst = step
    return worst


@fused_inlined_kernel
def cone_state(V, index, m):  # type: ignore[no-untyped-def]
    """The states that the natural map names at V[LAM]; False if a Newton step cannot reach them from there."""
    for i in range(m):
        k = 3 * i
        a, normal = V[SCALE, i], V[LAM, k]
        if a * normal <= V[W, k]:
            if normal > 0.0:
                return False
            index[KIND, i] = OPEN
            continue
        if normal <= 0.0:
            return False
        x1, x2 = a * V[LAM, k + 1] - V[W, k + 1], a * V[LAM, k + 2] - V[W, k + 2]
        radius = V[MU, i] * a * normal
        if x1 * x1 + x2 * x2 < radius * radius:
            index[KIND, i] = STICK
        else:
            index[KIND, i] = SLIP
            if radius > 0.0 and V[LAM, k + 1] == 0.0 and V[LAM, k + 2] == 0.0:
                return False
    return True


@fused_lean_kernel
def cone_sweep(A, V, index, m):  # type: ignore[no-untyped-def]
    """One pass of block Gauss-Seidel, w = A lam + b kept up; V[LAM], V[W] and the states are brought up to date.

    Each contact in turn is solved exactly for g_i = w_i - A_ii lam_i (`block_cone`).
    """
    for i in range(m):
        k = 3 * i
        g0, g1, g2 = velocity_without(A, V, k)
        index[KIND, i], x0, x1, x2 = block_cone(A, k, g0, g1, g2, V[MU, i], V[LAM, k + 1], V[LAM, k + 2])
        shift(A, V, k, x0, x1, x2, m)


@fused_lean_kernel
def cone_newton(A, V, index, m):  # type: ignore[no-untyped-def]
    """Newton step for the states: unknowns as in `qp_newton`, step left in V[X]. Returns its dimension.

    Sticking: A d_lam = -w. Slipping, with u = lam_t / |lam_t|, n across u and d_lam = d_s (1, mu u) + d_p (0, n):
    (A d_lam)_n = -w_n and n . (A d_lam)_t + |w_t| / |lam_t| d_p = -n . w_t, so that w_n = 0 and u opposes w_t. All
    sticking, the matrix is symmetric (Cholesky); a slipping contact makes it unsymmetric (LU).
    """
    size, symmetric = np.int64(0), True
    for i in range(m):
        k = 3 * i
        if index[KIND, i] == OPEN:
            continue
        if index[KIND, i] == STICK:
            for t in range(3):
                V[BASIS, size], V[BASIS + 1, size], V[BASIS + 2, size] = 0.0, 0.0, 0.0
                V[BASIS + t, size] = 1.0
                index[ROW, size] = k
                V[X, size] = -V[W, k + t]
                V[TOP + size, size] = 0.0
                size += 1
            continue
        symmetric = False
        squared = V[LAM, k + 1] * V[LAM, k + 1] + V[LAM, k + 2] * V[LAM, k + 2]
        mu, inverse = V[MU, i], 0.0
        if squared > 0.0:
            inverse = 1.0 / math.sqrt(squared)
        u1, u2 = inverse * V[LAM, k + 1], inverse * V[LAM, k + 2]
        V[BASIS, size], V[BASIS + 1, size], V[BASIS + 2, size] = 1.0, mu * u1, mu * u2
        index[ROW, size] = k
        V[X, size] = -V[W, k]
        V[TOP + size, size] = 0.0
        size += 1
        index[WIDTH, i] = 2 if squared > 0.0 else 1
        if squared > 0.0:
            V[BASIS, size], V[BASIS + 1, size], V[BASIS + 2, size] = 0.0, -u2, u1
            index[ROW, size] = k
            V[X, size] = -(u1 * V[W, k + 2] - u2 * V[W, k + 1])
            V[TOP + size, size] = max(-(u1 * V[W, k + 1] + u2 * V[W, k + 2]), 0.0) * inverse
            size += 1
    for v in range(size):
        k, e0, e1, e2 = index[ROW, v], V[BASIS, v], V[BASIS + 1, v], V[BASIS + 2, v]
        if e0 != 0.0:
            e1, e2 = 0.0, 0.0
        for j in range(3 * m):
            V[TRIAL, j] = e0 * A[k, j] + e1 * A[k + 1, j] + e2 * A[k + 2, j]
        curvature = V[TOP + v, v]
        project_row(V, index, TOP + v, m)
        V[TOP + v, v] = (1.0 + PROXIMAL_WEIGHT) * V[TOP + v, v] + curvature
    if symmetric:
        cholesky_solve(V, TOP, size, X)
    else:
        lu_solve(V, TOP, size, X)
    return size


@fused_lean_kernel
def cone_solve(A, V, index, m, tolerance, max_iterations):  # type: ignore[no-untyped-def]
    """Solve the contact-major problem A, V[B], V[MU] in place of V[LAM], the warm start.

    Returns:
        (status, KKT error [m/s], iterations).
    """
    contact_scales(A, V, m)
    multiply(A, V, LAM, W, m)
    kkt_error = cone_natural_map(V, LAM, W, m)
    if kkt_error <= tolerance:
        return SOLVED, kkt_error, 0
    quick = m > 1
    for iteration in range(1, max_iterations + 1):
        quick = quick and cone_state(V, index, m)
        if not quick:
            cone_sweep(A, V, index, m)
            kkt_error = cone_natural_map(V, LAM, W, m)
            if kkt_error <= tolerance:
                multiply(A, V, LAM, W, m)
                kkt_error = cone_natural_map(V, LAM, W, m)
                if kkt_error <= tolerance:
                    return SOLVED, kkt_error, iteration
            if not kkt_error < math.inf:
                return NOT_FINITE, math.inf, iteration
            if m == 1:
                continue
        size = cone_newton(A, V, index, m)
        length = 1.0
        for attempt in range(1 if quick else 3):
            if attempt == 1:
                length = free_length(V, index, m, size)
            manifold_step(V, index, m, size, length)
            multiply(A, V, TRIAL, TRIAL_W, m)
            trial_error = cone_natural_map(V, TRIAL, TRIAL_W, m)
            if trial_error < kkt_error:
                break
            if attempt > 0:
                length *= 0.3
        quick = trial_error < QUICK * kkt_error
        if trial_error < kkt_error:
            accept_trial(V, m)
            kkt_error = trial_error
            if kkt_error <= tolerance:
                return SOLVED, kkt_error, iteration
    return MAX_ITERATIONS, kkt_error, max_iterations
