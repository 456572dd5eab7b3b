"""The work array of the cone solvers, and the moves that both solvers make in it.

Inside the solvers a problem is contact-major (normal, t1, t2 of contact 0, then of contact 1, ..).
Vectors are rows of one work array V, so that nothing is allocated and no view is made (ten views
cost 200 ns; a step of a cube at rest takes 100 without them):

    V[W], V[TRIAL_W]    contact velocities A lam + b, of lam and of a trial
    V[LAM], V[TRIAL]    impulses
    V[B], V[MU]         the problem's b (or c), and friction by contact
    V[SCALE]            a_i by contact
    V[X], V[BASIS + t]  Newton step, and its unknowns' directions
    V[TOP + r]          Newton matrix
    index[KIND]         state of each contact
    index[ROW]          first row of each unknown's contact
"""

from __future__ import annotations

import math

import numpy as np

from tossid.kernels import fused_inlined_kernel, fused_lean_kernel, fused_part_kernel
from tossid.physics.solvers.blocks import OPEN, SLIP, STICK, cholesky_solve, cone_exit, lu_solve
from tossid.physics.solvers.problem import SolverStatus

SOLVED, MAX_ITERATIONS, INFEASIBLE, NOT_FINITE, INACCURATE = map(int, SolverStatus)
"""What became of a problem, as kernels compare it."""
W, TRIAL_W, LAM, TRIAL, B, MU, SCALE, X, BASIS = 0, 1, 2, 3, 4, 5, 6, 7, 8
TOP = 11
"""Rows of V by what they hold; the Newton matrix begins at TOP."""
KIND, ROW = 0, 1
"""Rows of the integers."""
PROXIMAL_WEIGHT = 1e-10
"""Share by which the Newton matrix's diagonal is raised: a singular one becomes regular."""


@fused_part_kernel
def work_arrays(n):  # type: ignore[no-untyped-def]
    """Work arrays (V, index) of the cone solvers for up to n contacts, to be used again and again."""
    return np.zeros((TOP + 6 * n, 3 * n + 1)), np.zeros((2, 3 * n + 1), dtype=np.int64)


@fused_part_kernel
def problem_rows(n):  # type: ignore[no-untyped-def]
    """(3 n,) of each contact-major row, its place in the order of `problem`."""
    rows = np.empty(3 * n, np.int64)
    for i in range(n):
        rows[3 * i], rows[3 * i + 1], rows[3 * i + 2] = i, n + 2 * i, n + 2 * i + 1
    return rows


@fused_inlined_kernel
def shift(A, V, k, x0, x1, x2, m):  # type: ignore[no-untyped-def]
    """Set the impulse of the contact at row k to x, and w += A_i^T (x - lam_i) in V[W]."""
    d0, d1, d2 = x0 - V[LAM, k], x1 - V[LAM, k + 1], x2 - V[LAM, k + 2]
    if d0 != 0.0 or d1 != 0.0 or d2 != 0.0:
        V[LAM, k], V[LAM, k + 1], V[LAM, k + 2] = x0, x1, x2
        for j in range(3 * m):
            V[W, j] += A[k, j] * d0 + A[k + 1, j] * d1 + A[k + 2, j] * d2


@fused_inlined_kernel
def velocity_without(A, V, k):  # type: ignore[no-untyped-def]
    """g_i = w_i - A_ii lam_i: the velocity that the contact at row k would have without its own impulse."""
    y0, y1, y2 = V[LAM, k], V[LAM, k + 1], V[LAM, k + 2]
    return (
        V[W, k] - (A[k, k] * y0 + A[k, k + 1] * y1 + A[k, k + 2] * y2),
        V[W, k + 1] - (A[k + 1, k] * y0 + A[k + 1, k + 1] * y1 + A[k + 1, k + 2] * y2),
        V[W, k + 2] - (A[k + 2, k] * y0 + A[k + 2, k + 1] * y1 + A[k + 2, k + 2] * y2),
    )


@fused_lean_kernel
def manifold_step(V, index, m, size, length):  # type: ignore[no-untyped-def]
    """V[TRIAL] = V[LAM] + length E V[X], E the unknowns' directions; then every contact is put back where it belongs.

    Slipping ones on their cones' surface, sticking ones into their cones, pulling ones at zero.
    """
    for j in range(3 * m):
        V[TRIAL, j] = V[LAM, j]
    for v in range(size):
        k = index[ROW, v]
        for t in range(3):
            V[TRIAL, k + t] += length * V[BASIS + t, v] * V[X, v]
    for i in range(m):
        kind = index[KIND, i]
        if kind == OPEN:
            continue
        k = 3 * i
        tangent = math.sqrt(V[TRIAL, k + 1] * V[TRIAL, k + 1] + V[TRIAL, k + 2] * V[TRIAL, k + 2])
        limit = V[MU, i] * V[TRIAL, k]
        if V[TRIAL, k] <= 0.0:
            V[TRIAL, k], V[TRIAL, k + 1], V[TRIAL, k + 2] = 0.0, 0.0, 0.0
        elif tangent > limit or (kind == SLIP and tangent > 0.0):
            V[TRIAL, k + 1] *= limit / tangent
            V[TRIAL, k + 2] *= limit / tangent


@fused_lean_kernel
def free_length(V, index, m, size):  # type: ignore[no-untyped-def]
    """The largest part (at most 1) of the Newton step at which no contact opens or leaves its cone."""
    for j in range(3 * m):
        V[TRIAL, j] = 0.0
    for v in range(size):
        for t in range(3):
            V[TRIAL, index[ROW, v] + t] += V[BASIS + t, v] * V[X, v]
    length = 1.0
    for i in range(m):
        k = 3 * i
        if index[KIND, i] == OPEN:
            continue
        d0, d1, d2 = length * V[TRIAL, k], length * V[TRIAL, k + 1], length * V[TRIAL, k + 2]
        if index[KIND, i] == STICK:
            length *= cone_exit(V[LAM, k], V[LAM, k + 1], V[LAM, k + 2], d0, d1, d2, V[MU, i])
        elif V[LAM, k] + d0 < 0.0:
            length *= V[LAM, k] / -d0
    return length


@fused_inlined_kernel
def add_unknown(V, index, v, k, e0, e1, e2, curvature):  # type: ignore[no-untyped-def]
    """Unknown v of the Newton step: the direction e of the contact at row k; its diagonal entry is kept for later."""
    V[BASIS, v], V[BASIS + 1, v], V[BASIS + 2, v] = e0, e1, e2
    index[ROW, v], V[TOP + v, v] = k, curvature


@fused_lean_kernel
def newton_step(A, V, index, m, exact):  # type: ignore[no-untyped-def]
    """Newton step (F^T A E + D) x = -F^T w; left in V[X]. Returns its dimension.

    Column v of E is unknown v's direction: V[BASIS + t, v] in its contact's coordinates, index[ROW, v] its contact's
    row. A sticking contact has three, a slipping one (1, mu u), with u = lam_t / |lam_t|, and n across u. D has
    max(-u . w_t, 0) / |lam_t| for the latter, the curvature of the cone's surface.

    Of the cone programme F is E, and the matrix is symmetric (Cholesky). Of the exact cone (`exact`) F has (1, 0, 0) in
    place of (1, mu u), so that w_n = 0 and u opposes w_t: one slipping contact makes the matrix unsymmetric (LU).
    """
    size, symmetric = 0, True
    for i in range(m):
        k = 3 * i
        if index[KIND, i] == STICK:
            for t in range(3):
                add_unknown(
                    V, index, size + t, k, 1.0 if t == 0 else 0.0, 1.0 if t == 1 else 0.0, 1.0 if t == 2 else 0.0, 0.0
                )
            size += 3
        elif index[KIND, i] == SLIP:
            symmetric = not exact
            squared, inverse = V[LAM, k + 1] * V[LAM, k + 1] + V[LAM, k + 2] * V[LAM, k + 2], 0.0
            if squared > 0.0:
                inverse = 1.0 / math.sqrt(squared)
            u1, u2 = inverse * V[LAM, k + 1], inverse * V[LAM, k + 2]
            add_unknown(V, index, size, k, 1.0, V[MU, i] * u1, V[MU, i] * u2, 0.0)
            size += 1
            if squared > 0.0:
                bent = max(-(u1 * V[W, k + 1] + u2 * V[W, k + 2]), 0.0) * inverse
                add_unknown(V, index, size, k, 0.0, -u2, u1, bent)
                size += 1
    for v in range(size):
        k, e0, e1, e2 = index[ROW, v], V[BASIS, v], V[BASIS + 1, v], V[BASIS + 2, v]
        if exact and e0 != 0.0:
            e1, e2 = 0.0, 0.0
        V[X, v] = -(e0 * V[W, k] + e1 * V[W, k + 1] + e2 * V[W, k + 2])
        for j in range(3 * m):
            V[TRIAL, j] = e0 * A[k, j] + e1 * A[k + 1, j] + e2 * A[k + 2, j]
        curvature = V[TOP + v, v]
        for u in range(v if symmetric else 0, size):  # of a symmetric matrix the upper triangle
            j = index[ROW, u]
            V[TOP + v, u] = (
                V[BASIS, u] * V[TRIAL, j] + V[BASIS + 1, u] * V[TRIAL, j + 1] + V[BASIS + 2, u] * V[TRIAL, j + 2]
            )
        V[TOP + v, v] = (1.0 + PROXIMAL_WEIGHT) * V[TOP + v, v] + curvature
    if symmetric:
        cholesky_solve(V, TOP, size, X)
    else:
        lu_solve(V, TOP, size, X)
    return size


@fused_inlined_kernel
def multiply(A, V, lam, w, m):  # type: ignore[no-untyped-def]
    """V[w] = A V[lam] + V[B]; A symmetric, contacts without impulse skipped."""
    for j in range(3 * m):
        V[w, j] = V[B, j]
    for i in range(m):
        k = 3 * i
        y0, y1, y2 = V[lam, k], V[lam, k + 1], V[lam, k + 2]
        if y0 != 0.0 or y1 != 0.0 or y2 != 0.0:
            for j in range(3 * m):
                V[w, j] += A[k, j] * y0 + A[k + 1, j] * y1 + A[k + 2, j] * y2


@fused_inlined_kernel
def accept_trial(V, m):  # type: ignore[no-untyped-def]
    """V[LAM], V[W] = V[TRIAL], V[TRIAL_W]."""
    for j in range(3 * m):
        V[LAM, j] = V[TRIAL, j]
        V[W, j] = V[TRIAL_W, j]


@fused_inlined_kernel
def contact_scales(A, V, m):  # type: ignore[no-untyped-def]
    """V[SCALE, i] = trace(A_ii) / 3, at least 1e-12 of the largest."""
    largest = 0.0
    for i in range(m):
        V[SCALE, i] = (A[3 * i, 3 * i] + A[3 * i + 1, 3 * i + 1] + A[3 * i + 2, 3 * i + 2]) / 3.0
        largest = max(largest, V[SCALE, i])
    floor = 1e-12 * largest
    if not floor > 0.0:
        floor = 1.0
    for i in range(m):
        V[SCALE, i] = max(V[SCALE, i], floor)
