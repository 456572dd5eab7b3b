"""The Newton step that the cone solvers share, on the manifold that the contacts' states name."""

from __future__ import annotations

import math

import numpy as np

from tossid.kernels import fused_lean_kernel
from tossid.physics.solvers.blocks import cholesky_solve, lu_solve
from tossid.physics.solvers.workspace import (
    BASIS,
    KIND,
    LAM,
    MU,
    OPEN,
    ROW,
    STICK,
    TOP,
    TRIAL,
    WIDTH,
    W,
    X,
    project_row,
)

PROXIMAL_WEIGHT = 1e-10
"""Share by which the Newton matrix's diagonal is raised: a singular one becomes regular."""


@fused_lean_kernel
def newton_step(A, V, index, m, exact):  # type: ignore[no-untyped-def]
    """Newton step (F^T A E + D) x = -F^T w; left in V[X]. Returns its dimension.

    Column v of E is unknown v's direction: V[BASIS + t, v] in its contact's coordinates, index[ROW, v] its contact's
    row. A sticking contact has three, a slipping one (1, mu u), with u = lam_t / |lam_t|, and n across u. D has
    max(-u . w_t, 0) / |lam_t| for the latter, the curvature of the cone's surface.

    Of the cone programme F is E, and the matrix is symmetric (Cholesky). Of the exact cone (`exact`) F has (1, 0, 0) in
    place of (1, mu u), so that w_n = 0 and u opposes w_t: one slipping contact makes the matrix unsymmetric (LU).
    """
    size, symmetric = np.int64(0), True  # not a literal, of which Numba would compile a second version
    for i in range(m):
        k = 3 * i
        if index[KIND, i] == OPEN:
            continue
        if index[KIND, i] == STICK:
            for t in range(3):
                V[BASIS, size], V[BASIS + 1, size], V[BASIS + 2, size] = 0.0, 0.0, 0.0
                V[BASIS + t, size] = 1.0
                index[ROW, size] = k
                V[TOP + size, size] = 0.0
                size += 1
            continue
        symmetric = not exact
        squared, inverse = V[LAM, k + 1] * V[LAM, k + 1] + V[LAM, k + 2] * V[LAM, k + 2], 0.0
        if squared > 0.0:
            inverse = 1.0 / math.sqrt(squared)
        u1, u2 = inverse * V[LAM, k + 1], inverse * V[LAM, k + 2]
        V[BASIS, size], V[BASIS + 1, size], V[BASIS + 2, size] = 1.0, V[MU, i] * u1, V[MU, i] * u2
        index[ROW, size] = k
        V[TOP + size, size] = 0.0
        size += 1
        index[WIDTH, i] = 2 if squared > 0.0 else 1
        if squared > 0.0:
            V[BASIS, size], V[BASIS + 1, size], V[BASIS + 2, size] = 0.0, -u2, u1
            index[ROW, size] = k
            V[TOP + size, size] = max(-(u1 * V[W, k + 1] + u2 * V[W, k + 2]), 0.0) * inverse
            size += 1
    for v in range(size):
        k, e0, e1, e2 = index[ROW, v], V[BASIS, v], V[BASIS + 1, v], V[BASIS + 2, v]
        if exact and e0 != 0.0:
            e1, e2 = 0.0, 0.0
        V[X, v] = -(e0 * V[W, k] + e1 * V[W, k + 1] + e2 * V[W, k + 2])
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
