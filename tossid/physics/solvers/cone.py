"""The exact friction cone of one time step: non-penetration and maximum dissipation.

    0 <= lam_n  _|_  w_n >= 0,   lam_t = argmin over |lam_t| <= mu lam_n of lam_t . w_t,   w = A lam + b

(Moreau 1988; Stewart & Trinkle 1996 before the cone becomes a polyhedron.) The problem is not
convex. Two moves alternate:

1. a sweep of projected Gauss-Seidel, each contact solved exactly (`block_cone`);
2. a Newton step on the equations of the state that the sweep found (open: lam_i = 0;
   sticking: w_i = 0; slipping: w_n = 0 and u x w_t = 0 with lam_i = s (1, mu u)), taken if
   the residual falls.

Where they stall, the problem is solved as a sequence of convex cone programmes (de Saxce's
change of variable, iterated as by Cadoux 2009): c_n = b_n + mu |w_t| held, solved, renewed.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from tossid.physics.solvers.batches import check_batch, over_threads
from tossid.physics.solvers.blocks import OPEN, STICK, block_cone, cholesky_solve, jit, lu_solve
from tossid.physics.solvers.cone_qp import (
    MAX_ITERATIONS,
    NOT_FINITE,
    SOLVED,
    contact_scales,
    free_length,
    manifold_step,
    multiply,
    solve_cone_qp,
)
from tossid.physics.solvers.lcp import solve_lcp
from tossid.physics.solvers.problem import DEFAULT_TOLERANCE, Array, ContactSolution
from tossid.physics.solvers.rescue import rescue_cone

WORK_ROWS = 16
_PROXIMAL = 1e-10


def cone_work(n: int) -> tuple[Array, NDArray[np.int64]]:
    """Work arrays of `cone_kernel` and `cone_core` for n contacts, to be used again and again."""
    return np.empty((6 * n + WORK_ROWS, 3 * n)), np.empty((3, 3 * n), dtype=np.int64)


@jit
def cone_natural_map(lam, w, mu, scale, m):  # type: ignore[no-untyped-def]
    """The residual `problem.cone_residual` [m/s], contact-major."""
    worst = 0.0
    for i in range(m):
        k = 3 * i
        a, normal = scale[i], lam[k]
        x1, x2 = a * lam[k + 1] - w[k + 1], a * lam[k + 2] - w[k + 2]
        radius, reach = mu[i] * a * max(normal, 0.0), x1 * x1 + x2 * x2
        if reach > radius * radius:
            part = radius / math.sqrt(reach)
            x1, x2 = part * x1, part * x2
        d1, d2 = a * lam[k + 1] - x1, a * lam[k + 2] - x2
        step = max(abs(min(a * normal, w[k])), math.sqrt(d1 * d1 + d2 * d2))
        if not step <= worst:
            worst = step
    return worst


@jit
def cone_sweep(A, lam, w, mu, kind, m):  # type: ignore[no-untyped-def]
    """One pass of projected Gauss-Seidel; lam, w = A lam + b and kind are brought up to date."""
    for i in range(m):
        k = 3 * i
        y0, y1, y2 = lam[k], lam[k + 1], lam[k + 2]
        g0 = w[k] - (A[k, k] * y0 + A[k, k + 1] * y1 + A[k, k + 2] * y2)
        g1 = w[k + 1] - (A[k + 1, k] * y0 + A[k + 1, k + 1] * y1 + A[k + 1, k + 2] * y2)
        g2 = w[k + 2] - (A[k + 2, k] * y0 + A[k + 2, k + 1] * y1 + A[k + 2, k + 2] * y2)
        kind[i], x0, x1, x2 = block_cone(A, k, g0, g1, g2, mu[i], y1, y2)
        d0, d1, d2 = x0 - y0, x1 - y1, x2 - y2
        if d0 != 0.0 or d1 != 0.0 or d2 != 0.0:
            lam[k], lam[k + 1], lam[k + 2] = x0, x1, x2
            for j in range(3 * m):
                w[j] += A[k, j] * d0 + A[k + 1, j] * d1 + A[k + 2, j] * d2


@jit
def cone_newton(A, lam, w, mu, kind, m, H, x, basis, row, product):  # type: ignore[no-untyped-def]
    """Newton step for the state `kind`: unknowns as in `qp_newton`, step left in x. Returns its dimension.

    All sticking, the matrix is symmetric (Cholesky); a slipping contact makes it unsymmetric (LU).
    """
    size, symmetric = 0, True
    for i in range(m):
        k = 3 * i
        if kind[i] == OPEN:
            continue
        if kind[i] == STICK:
            for t in range(3):
                basis[0, size], basis[1, size], basis[2, size] = 0.0, 0.0, 0.0
                basis[t, size] = 1.0
                row[size] = k
                x[size] = -w[k + t]
                H[size, size] = 0.0
                size += 1
            continue
        symmetric = False
        tangent = math.sqrt(lam[k + 1] * lam[k + 1] + lam[k + 2] * lam[k + 2])
        u1, u2 = 0.0, 0.0
        if tangent > 0.0:
            u1, u2 = lam[k + 1] / tangent, lam[k + 2] / tangent
        basis[0, size], basis[1, size], basis[2, size] = 1.0, mu[i] * u1, mu[i] * u2
        row[size] = k
        x[size] = -w[k]
        H[size, size] = 0.0
        size += 1
        if tangent > 0.0:
            basis[0, size], basis[1, size], basis[2, size] = 0.0, -u2, u1
            row[size] = k
            x[size] = -(u1 * w[k + 2] - u2 * w[k + 1])
            H[size, size] = max(-(u1 * w[k + 1] + u2 * w[k + 2]), 0.0) / tangent
            size += 1
    for v in range(size):
        k, e0, e1, e2 = row[v], basis[0, v], basis[1, v], basis[2, v]
        if e0 != 0.0:
            e1, e2 = 0.0, 0.0
        for j in range(3 * m):
            product[j] = e0 * A[k, j] + e1 * A[k + 1, j] + e2 * A[k + 2, j]
        curvature = H[v, v]
        for u in range(v if symmetric else 0, size):
            r = row[u]
            H[v, u] = basis[0, u] * product[r] + basis[1, u] * product[r + 1] + basis[2, u] * product[r + 2]
        H[v, v] = (1.0 + _PROXIMAL) * H[v, v] + curvature
    if symmetric:
        cholesky_solve(H, size, x)
    else:
        lu_solve(H, size, x)
    return size


@jit
def cone_core(A, b, mu, lam, m, tolerance, max_iterations, work, index):  # type: ignore[no-untyped-def]
    """Solve a contact-major problem of m contacts in place of lam. Returns (status, residual, iterations).

    A (3 m or more, ..), b (3 m,), lam (3 m,) in the order n, t1, t2 of contact 0, then of contact 1, ..;
    mu (m,). lam is the warm start. work, index: from `cone_work(m or more)`.
    """
    n = index.shape[1] // 3
    H, vectors = work, work[6 * n :]
    w, trial, trial_w, x, scale = vectors[0], vectors[1], vectors[2], vectors[3], vectors[4]
    basis, kind, row = vectors[5:8], index[0], index[1]
    contact_scales(A, m, scale)
    multiply(A, lam, b, m, w)
    residual = cone_natural_map(lam, w, mu, scale, m)
    if residual <= tolerance:
        return SOLVED, residual, 0
    for iteration in range(1, max_iterations + 1):
        cone_sweep(A, lam, w, mu, kind, m)
        residual = cone_natural_map(lam, w, mu, scale, m)
        if residual <= tolerance:
            multiply(A, lam, b, m, w)
            residual = cone_natural_map(lam, w, mu, scale, m)
            if residual <= tolerance:
                return SOLVED, residual, iteration
        if not residual < math.inf:
            return NOT_FINITE, math.inf, iteration
        if m == 1:
            continue
        size = cone_newton(A, lam, w, mu, kind, m, H, x, basis, row, trial)
        length = 1.0
        for attempt in range(3):
            if attempt == 1:
                length = free_length(lam, mu, kind, m, x, basis, row, size, trial)
            manifold_step(lam, mu, kind, m, x, basis, row, size, length, trial)
            multiply(A, trial, b, m, trial_w)
            trial_residual = cone_natural_map(trial, trial_w, mu, scale, m)
            if trial_residual < residual:
                for j in range(3 * m):
                    lam[j] = trial[j]
                    w[j] = trial_w[j]
                residual = trial_residual
                break
            if attempt > 0:
                length *= 0.3
        if residual <= tolerance:
            return SOLVED, residual, iteration
    return MAX_ITERATIONS, residual, max_iterations


@jit
def cone_kernel(A, b, mu, active, lam, tolerance, max_iterations, work, index):  # type: ignore[no-untyped-def]
    """Solve one problem in the order [n.., t1 t2 ..]; lam is the warm start and receives the answer.

    Args:
        A (3 n, 3 n), b (3 n,), mu (n,), active (n,) bool (others get lam = 0), lam (3 n,).
        tolerance [m/s]. work, index: from `cone_work(n)`.

    Returns:
        (status, residual [m/s], iterations).
    """
    n = mu.shape[0]
    vectors, chosen = work[6 * n :], index[2]
    lam_l, b_l, mu_l = vectors[8], vectors[9], vectors[10]
    m = 0
    closed, total = True, 0.0
    for i in range(n):
        t = n + 2 * i
        if not active[i]:
            lam[i], lam[t], lam[t + 1] = 0.0, 0.0, 0.0
            continue
        chosen[m] = i
        mu_l[m] = mu[i]
        b_l[3 * m], b_l[3 * m + 1], b_l[3 * m + 2] = b[i], b[t], b[t + 1]
        lam_l[3 * m], lam_l[3 * m + 1], lam_l[3 * m + 2] = lam[i], lam[t], lam[t + 1]
        closed = closed and b[i] >= 0.0
        total += b[i] + b[t] + b[t + 1] + mu[i]
        m += 1
    status, residual, iterations = SOLVED, 0.0, 0
    if not abs(total) < math.inf:
        status, residual = NOT_FINITE, math.inf
    if m == 0 or closed or status != SOLVED:
        for j in range(3 * n):
            lam[j] = 0.0
        return status, residual, iterations
    local = work[3 * n : 6 * n]
    for a in range(m):
        i, t, p = chosen[a], n + 2 * chosen[a], 3 * a
        for c in range(m):
            j, s, r = chosen[c], n + 2 * chosen[c], 3 * c
            local[p, r], local[p, r + 1], local[p, r + 2] = A[i, j], A[i, s], A[i, s + 1]
            local[p + 1, r], local[p + 1, r + 1], local[p + 1, r + 2] = A[t, j], A[t, s], A[t, s + 1]
            local[p + 2, r], local[p + 2, r + 1], local[p + 2, r + 2] = A[t + 1, j], A[t + 1, s], A[t + 1, s + 1]
    status, residual, iterations = cone_core(local, b_l, mu_l, lam_l, m, tolerance, max_iterations, work, index)
    for a in range(m):
        i, t = chosen[a], n + 2 * chosen[a]
        lam[i], lam[t], lam[t + 1] = lam_l[3 * a], lam_l[3 * a + 1], lam_l[3 * a + 2]
    if status == NOT_FINITE:
        for j in range(3 * n):
            lam[j] = 0.0
    return status, residual, iterations


@jit
def cone_batch(  # type: ignore[no-untyped-def]
    A, b, mu, active, lam, status, residual, iterations, tolerance, max_iterations, first, last
):
    """`cone_kernel` on problems first..last-1 of a batch, one after another."""
    n = mu.shape[1]
    work = np.empty((6 * n + WORK_ROWS, 3 * n))
    index = np.empty((3, 3 * n), dtype=np.int64)
    for k in range(first, last):
        status[k], residual[k], iterations[k] = cone_kernel(
            A[k], b[k], mu[k], active[k], lam[k], tolerance, max_iterations, work, index
        )


def solve_cone(
    A: Array,
    b: Array,
    mu: Array,
    *,
    active: NDArray[np.bool_] | None = None,
    warm: Array | None = None,
    tolerance: float = DEFAULT_TOLERANCE,
    max_iterations: int = 60,
    n_threads: int = 1,
) -> ContactSolution:
    """Solve a batch of contact problems with the exact friction cone.

    Args:
        A: (B, 3 n, 3 n) [1/kg] Delassus matrices, symmetric, positive semi-definite.
        b: (B, 3 n) [m/s]. mu: (n,) or (B, n) friction coefficients, at least 0.
        active: (B, n); contacts that are not active get lam = 0. All if None.
        warm: (B, 3 n) [N s] impulses to start from; zero if None.
        tolerance: [m/s] on the natural map (`problem.cone_residual`).
        max_iterations: of the quick kernel; problems that reach it are solved again as a sequence
            of cone programmes.
        n_threads: the batch is split over this many threads (the kernels release the GIL).

    Returns:
        `ContactSolution`; lam (B, 3 n) [N s] in the order [n.., t1 t2 ..].

    Raises:
        InputError: shapes that do not fit, or a negative mu.
    """
    A, b, mu, chosen, lam = check_batch(A, b, mu, active, warm)
    status = np.empty(len(b), dtype=np.uint8)
    residual, iterations = np.empty(len(b)), np.empty(len(b), dtype=np.int64)

    def part(first: int, last: int) -> None:
        cone_batch(A, b, mu, chosen, lam, status, residual, iterations, tolerance, max_iterations, first, last)

    over_threads(part, len(b), n_threads)
    work, index = cone_work(mu.shape[1])
    for k in np.flatnonzero(status == MAX_ITERATIONS).tolist():

        def programme(c: Array, warm: Array, k: int = k) -> None:
            found = solve_cone_qp(A[k : k + 1], c[None], mu[k : k + 1], active=chosen[k : k + 1], warm=warm[None])
            warm[:] = found.lam[0]

        def attempt(warm: Array, limit: int, k: int = k) -> tuple[int, float, int]:
            return cone_kernel(A[k], b[k], mu[k], chosen[k], warm, tolerance, limit, work, index)

        near = solve_lcp(A[k : k + 1], b[k : k + 1], mu[k : k + 1], active=chosen[k : k + 1], n_directions=16).lam[0]
        status[k], residual[k] = rescue_cone(
            A[k], b[k], mu[k], lam[k], float(residual[k]), polyhedral=near, programme=programme, attempt=attempt
        )
    return ContactSolution(lam, status, residual, iterations)
