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
    index[KIND], index[WIDTH]
                        state and number of unknowns of each contact
    index[ROW]          first row of each unknown's contact
"""

from __future__ import annotations

import math

import numpy as np

from tossid.kernels import fused_inlined_kernel, fused_lean_kernel, fused_part_kernel

SOLVED, MAX_ITERATIONS, INFEASIBLE, NOT_FINITE, INACCURATE = 0, 1, 2, 3, 4
"""What became of a problem (`problem.SolverStatus`)."""
OPEN, STICK, SLIP = 0, 1, 2
"""State of a contact."""
W, TRIAL_W, LAM, TRIAL, B, MU, SCALE, X, BASIS = 0, 1, 2, 3, 4, 5, 6, 7, 8
TOP = 11
"""Rows of V by what they hold; the Newton matrix begins at TOP."""
KIND, ROW, WIDTH = 0, 1, 2
"""Rows of the integers."""


@fused_part_kernel
def work_arrays(n):  # type: ignore[no-untyped-def]
    """Work arrays (V, index) of the cone solvers for up to n contacts, to be used again and again."""
    return np.zeros((TOP + 6 * n, 3 * n + 1)), np.zeros((3, 3 * n + 1), dtype=np.int64)


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
def cone_exit(y0, y1, y2, d0, d1, d2, mu):  # type: ignore[no-untyped-def]
    """The largest p <= 1 for which y + p d is inside the cone |y_t| <= mu y_n, which y is in.

    The root of |y_t + p d_t|² = mu² (y_n + p d_n)².
    """
    part = 1.0
    if y0 + d0 < 0.0:
        part = y0 / -d0
    squared = mu * mu
    a = d1 * d1 + d2 * d2 - squared * d0 * d0
    b = y1 * d1 + y2 * d2 - squared * y0 * d0
    c = min(y1 * y1 + y2 * y2 - squared * y0 * y0, 0.0)
    if a * part * part + 2.0 * b * part + c > 0.0:
        root = b + math.sqrt(max(b * b - a * c, 0.0))
        if root > 0.0:
            part = min(part, -c / root)
    return part


@fused_lean_kernel
def project_row(V, index, row, m):  # type: ignore[no-untyped-def]
    """V[row] = E^T V[TRIAL], E the directions of the Newton step's unknowns, contact after contact."""
    u = 0
    for i in range(m):
        k, kind = 3 * i, index[KIND, i]
        if kind == STICK:
            V[row, u], V[row, u + 1], V[row, u + 2] = V[TRIAL, k], V[TRIAL, k + 1], V[TRIAL, k + 2]
            u += 3
        elif kind == SLIP:
            t1, t2 = V[TRIAL, k + 1], V[TRIAL, k + 2]
            V[row, u] = V[TRIAL, k] + V[BASIS + 1, u] * t1 + V[BASIS + 2, u] * t2
            u += 1
            if index[WIDTH, i] == 2:
                V[row, u] = V[BASIS + 1, u] * t1 + V[BASIS + 2, u] * t2
                u += 1


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


@fused_lean_kernel
def gather(b, mu, lam, V):  # type: ignore[no-untyped-def]
    """V[B], V[MU], V[LAM] from the caller's order, contact-major; returns a sum that is finite if the numbers are."""
    n = mu.shape[0]
    total = 0.0
    for i in range(n):
        t = n + 2 * i
        V[MU, i] = mu[i]
        V[B, 3 * i], V[B, 3 * i + 1], V[B, 3 * i + 2] = b[i], b[t], b[t + 1]
        V[LAM, 3 * i], V[LAM, 3 * i + 1], V[LAM, 3 * i + 2] = lam[i], lam[t], lam[t + 1]
        total += abs(b[i]) + abs(b[t]) + abs(b[t + 1]) + abs(mu[i])
    return total


@fused_lean_kernel
def gather_matrix(A, local, n):  # type: ignore[no-untyped-def]
    """The rows and columns of A into `local`, contact-major."""
    for i in range(n):
        for t in range(3):
            row = i if t == 0 else n + 2 * i + t - 1
            for j in range(n):
                local[3 * i + t, 3 * j] = A[row, j]
                local[3 * i + t, 3 * j + 1] = A[row, n + 2 * j]
                local[3 * i + t, 3 * j + 2] = A[row, n + 2 * j + 1]


@fused_lean_kernel
def scatter(lam, V, n, status):  # type: ignore[no-untyped-def]
    """V[LAM] back into the caller's order; all zero if the status is NOT_FINITE."""
    if status == NOT_FINITE:
        lam[:] = 0.0
        return
    for i in range(n):
        t = n + 2 * i
        lam[i], lam[t], lam[t + 1] = V[LAM, 3 * i], V[LAM, 3 * i + 1], V[LAM, 3 * i + 2]
