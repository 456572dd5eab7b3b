"""The cone programme: min over the friction cones of 1/2 lam^T A lam + c^T lam (convex).

It is the inner problem of the ContactNets loss (Pfrommer, Halm & Posa 2020, eq. 14 ff.).
Two moves alternate, and both can only lower the objective:

1. a sweep of block coordinate descent, each contact solved exactly (`block_qp`). It tells
   open, sticking and slipping contacts apart;
2. a Newton step on the manifold that this names: lam_i = 0 where open, free where sticking,
   s (1, mu u) on the cone's surface where slipping, with the surface's curvature; projected
   back, and taken if the objective or the residual falls.

The first converges from anywhere, the second quadratically at the end, also where A is
singular (four corners on a plane): redundant directions stay where the sweep put them.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from tossid.physics.solvers.batches import check_batch, over_threads
from tossid.physics.solvers.blocks import OPEN, SLIP, STICK, block_qp, cholesky_solve, cone_exit, jit
from tossid.physics.solvers.problem import DEFAULT_TOLERANCE, Array, ContactSolution
from tossid.physics.solvers.rescue import interior_start, rescue_programme

SOLVED, MAX_ITERATIONS, INFEASIBLE, NOT_FINITE = 0, 1, 2, 3

WORK_ROWS = 11
_PROXIMAL = 1e-10


def qp_work(n: int) -> tuple[Array, NDArray[np.int64]]:
    """Work arrays of `cone_qp_kernel` for n contacts, to be used again and again."""
    return np.empty((6 * n + WORK_ROWS, 3 * n)), np.empty((3, 3 * n), dtype=np.int64)


@jit
def qp_residual(lam, w, mu, scale, m):  # type: ignore[no-untyped-def]
    """The natural map of the cone programme (`problem.cone_qp_residual`), contact-major."""
    worst = 0.0
    for i in range(m):
        k = 3 * i
        a = scale[i]
        x0, x1, x2 = lam[k] - w[k] / a, lam[k + 1] - w[k + 1] / a, lam[k + 2] - w[k + 2] / a
        tangent = math.sqrt(x1 * x1 + x2 * x2)
        if tangent > mu[i] * x0 or x0 < 0.0:
            s = (x0 + mu[i] * tangent) / (1.0 + mu[i] * mu[i])
            if s <= 0.0 or tangent == 0.0:
                x0, x1, x2 = max(s, 0.0), 0.0, 0.0
            else:
                x0, x1, x2 = s, mu[i] * s * x1 / tangent, mu[i] * s * x2 / tangent
        d0, d1, d2 = lam[k] - x0, lam[k + 1] - x1, lam[k + 2] - x2
        step = a * math.sqrt(d0 * d0 + d1 * d1 + d2 * d2)
        if not step <= worst:
            worst = step
    return worst


@jit
def qp_sweep(A, lam, w, mu, kind, m):  # type: ignore[no-untyped-def]
    """One pass of block coordinate descent; lam, w = A lam + c and kind are brought up to date."""
    for i in range(m):
        k = 3 * i
        y0, y1, y2 = lam[k], lam[k + 1], lam[k + 2]
        g0 = w[k] - (A[k, k] * y0 + A[k, k + 1] * y1 + A[k, k + 2] * y2)
        g1 = w[k + 1] - (A[k + 1, k] * y0 + A[k + 1, k + 1] * y1 + A[k + 1, k + 2] * y2)
        g2 = w[k + 2] - (A[k + 2, k] * y0 + A[k + 2, k + 1] * y1 + A[k + 2, k + 2] * y2)
        kind[i], x0, x1, x2 = block_qp(A, k, g0, g1, g2, mu[i], y1, y2)
        d0, d1, d2 = x0 - y0, x1 - y1, x2 - y2
        if d0 != 0.0 or d1 != 0.0 or d2 != 0.0:
            lam[k], lam[k + 1], lam[k + 2] = x0, x1, x2
            for j in range(3 * m):
                w[j] += A[k, j] * d0 + A[k + 1, j] * d1 + A[k + 2, j] * d2


@jit
def qp_newton(A, lam, w, mu, kind, m, H, x, basis, row, product):  # type: ignore[no-untyped-def]
    """Newton step on the manifold named by `kind`. Returns its dimension; the step is left in x[:dimension].

    basis[:, v] of shape (3, 3 m) holds unknown v's direction in its contact's coordinates, row[v] its contact's row.
    """
    size = 0
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
        tangent = math.sqrt(lam[k + 1] * lam[k + 1] + lam[k + 2] * lam[k + 2])
        u1, u2 = 0.0, 0.0
        if tangent > 0.0:
            u1, u2 = lam[k + 1] / tangent, lam[k + 2] / tangent
        basis[0, size], basis[1, size], basis[2, size] = 1.0, mu[i] * u1, mu[i] * u2
        row[size] = k
        x[size] = -(w[k] + mu[i] * (u1 * w[k + 1] + u2 * w[k + 2]))
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
        for j in range(3 * m):
            product[j] = e0 * A[k, j] + e1 * A[k + 1, j] + e2 * A[k + 2, j]
        curvature = H[v, v]
        for u in range(v, size):
            r = row[u]
            H[v, u] = basis[0, u] * product[r] + basis[1, u] * product[r + 1] + basis[2, u] * product[r + 2]
        H[v, v] = (1.0 + _PROXIMAL) * H[v, v] + curvature
    cholesky_solve(H, size, x)
    return size


@jit
def manifold_step(lam, mu, kind, m, x, basis, row, size, length, trial):  # type: ignore[no-untyped-def]
    """trial = lam moved along the Newton step by `length`, slipping contacts back on their cones' surface,

    sticking ones inside their cones."""
    for j in range(3 * m):
        trial[j] = lam[j]
    for v in range(size):
        k = row[v]
        for t in range(3):
            trial[k + t] += length * basis[t, v] * x[v]
    for i in range(m):
        if kind[i] == OPEN:
            continue
        k = 3 * i
        tangent = math.sqrt(trial[k + 1] * trial[k + 1] + trial[k + 2] * trial[k + 2])
        limit = mu[i] * trial[k]
        if trial[k] <= 0.0:
            trial[k], trial[k + 1], trial[k + 2] = 0.0, 0.0, 0.0
        elif tangent > limit or (kind[i] == SLIP and tangent > 0.0):
            trial[k + 1] *= limit / tangent
            trial[k + 2] *= limit / tangent


@jit
def free_length(lam, mu, kind, m, x, basis, row, size, step):  # type: ignore[no-untyped-def]
    """The largest part (at most 1) of the Newton step at which no contact opens or leaves its cone."""
    for j in range(3 * m):
        step[j] = 0.0
    for v in range(size):
        for t in range(3):
            step[row[v] + t] += basis[t, v] * x[v]
    length = 1.0
    for i in range(m):
        k = 3 * i
        if kind[i] == OPEN:
            continue
        if kind[i] == STICK:
            y0, y1, y2 = length * step[k], length * step[k + 1], length * step[k + 2]
            length *= cone_exit(lam[k], lam[k + 1], lam[k + 2], y0, y1, y2, mu[i])
        elif lam[k] + length * step[k] < 0.0:
            length = lam[k] / -step[k]
    return length


@jit
def multiply(A, lam, c, m, out):  # type: ignore[no-untyped-def]
    """out = A lam + c for the leading m contacts; A symmetric, contacts without impulse skipped."""
    for j in range(3 * m):
        out[j] = c[j]
    for i in range(m):
        k = 3 * i
        y0, y1, y2 = lam[k], lam[k + 1], lam[k + 2]
        if y0 != 0.0 or y1 != 0.0 or y2 != 0.0:
            for j in range(3 * m):
                out[j] += A[k, j] * y0 + A[k + 1, j] * y1 + A[k + 2, j] * y2


@jit
def contact_scales(A, m, scale):  # type: ignore[no-untyped-def]
    """scale[i] = trace(A_ii) / 3, floored as in `problem.contact_scale`."""
    largest = 0.0
    for i in range(m):
        scale[i] = (A[3 * i, 3 * i] + A[3 * i + 1, 3 * i + 1] + A[3 * i + 2, 3 * i + 2]) / 3.0
        largest = max(largest, scale[i])
    floor = 1e-12 * largest
    if not floor > 0.0:
        floor = 1.0
    for i in range(m):
        scale[i] = max(scale[i], floor)


@jit
def qp_core(A, c, mu, lam, m, tolerance, max_iterations, H, vectors, kind, row):  # type: ignore[no-untyped-def]
    """Solve a contact-major programme of m contacts in place of lam. Returns (status, residual, iterations)."""
    w, trial, trial_w, x, scale = vectors[0], vectors[1], vectors[2], vectors[3], vectors[4]
    basis = vectors[5:8]
    contact_scales(A, m, scale)
    multiply(A, lam, c, m, w)
    residual = qp_residual(lam, w, mu, scale, m)
    if residual <= tolerance:
        return SOLVED, residual, 0
    for iteration in range(1, max_iterations + 1):
        qp_sweep(A, lam, w, mu, kind, m)
        residual = qp_residual(lam, w, mu, scale, m)
        if residual <= tolerance:
            multiply(A, lam, c, m, w)
            residual = qp_residual(lam, w, mu, scale, m)
            if residual <= tolerance:
                return SOLVED, residual, iteration
        if not residual < math.inf:
            break
        size = qp_newton(A, lam, w, mu, kind, m, H, x, basis, row, trial)
        value = 0.0
        for j in range(3 * m):
            value += lam[j] * (w[j] + c[j])
        length = 1.0
        for attempt in range(10):
            if attempt == 1:
                length = free_length(lam, mu, kind, m, x, basis, row, size, trial)
            manifold_step(lam, mu, kind, m, x, basis, row, size, length, trial)
            multiply(A, trial, c, m, trial_w)
            trial_value = 0.0
            for j in range(3 * m):
                trial_value += trial[j] * (trial_w[j] + c[j])
            trial_residual = qp_residual(trial, trial_w, mu, scale, m)
            if trial_value < value or trial_residual < residual:
                for j in range(3 * m):
                    lam[j] = trial[j]
                    w[j] = trial_w[j]
                residual = trial_residual
                break
            if attempt > 0:
                length *= 0.3
        if residual <= tolerance:
            return SOLVED, residual, iteration
    if residual < math.inf:
        return MAX_ITERATIONS, residual, max_iterations
    return NOT_FINITE, math.inf, max_iterations


@jit
def cone_qp_kernel(  # type: ignore[no-untyped-def]
    A, c, mu, active, lam, tolerance, max_iterations, regularization, work, index
):
    """Solve one programme in the order [n.., t1 t2 ..]; lam is the warm start and receives the answer.

    Args:
        A (3 n, 3 n), c (3 n,), mu (n,), active (n,) bool (others get lam = 0), lam (3 n,).
        tolerance: [unit of c] on the natural map. regularization: added to A's diagonal.
        work, index: from `qp_work(n)`.

    Returns:
        (status, residual, iterations).
    """
    n = mu.shape[0]
    kind, row, chosen = index[0], index[1], index[2]
    vectors = work[6 * n :]
    lam_l, c_l, mu_l = vectors[8], vectors[9], vectors[10]
    m = 0
    closed, total = True, 0.0
    for i in range(n):
        t = n + 2 * i
        if not active[i]:
            lam[i], lam[t], lam[t + 1] = 0.0, 0.0, 0.0
            continue
        chosen[m] = i
        mu_l[m] = mu[i]
        c_l[3 * m], c_l[3 * m + 1], c_l[3 * m + 2] = c[i], c[t], c[t + 1]
        lam_l[3 * m], lam_l[3 * m + 1], lam_l[3 * m + 2] = lam[i], lam[t], lam[t + 1]
        closed = closed and c[i] >= mu[i] * math.sqrt(c[t] * c[t] + c[t + 1] * c[t + 1])
        total += c[i] + c[t] + c[t + 1] + mu[i]
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
        for b in range(m):
            j, s, r = chosen[b], n + 2 * chosen[b], 3 * b
            local[p, r], local[p, r + 1], local[p, r + 2] = A[i, j], A[i, s], A[i, s + 1]
            local[p + 1, r], local[p + 1, r + 1], local[p + 1, r + 2] = A[t, j], A[t, s], A[t, s + 1]
            local[p + 2, r], local[p + 2, r + 1], local[p + 2, r + 2] = A[t + 1, j], A[t + 1, s], A[t + 1, s + 1]
        for k in range(3):
            local[p + k, p + k] += regularization
    status, residual, iterations = qp_core(
        local, c_l, mu_l, lam_l, m, tolerance, max_iterations, work, vectors, kind, row
    )
    for a in range(m):
        i, t = chosen[a], n + 2 * chosen[a]
        lam[i], lam[t], lam[t + 1] = lam_l[3 * a], lam_l[3 * a + 1], lam_l[3 * a + 2]
    if status == NOT_FINITE:
        for j in range(3 * n):
            lam[j] = 0.0
    return status, residual, iterations


@jit
def cone_qp_batch(  # type: ignore[no-untyped-def]
    A, c, mu, active, lam, status, residual, iterations, tolerance, max_iterations, regularization, first, last
):
    """`cone_qp_kernel` on problems first..last-1 of a batch, one after another."""
    n = mu.shape[1]
    work = np.empty((6 * n + WORK_ROWS, 3 * n))
    index = np.empty((3, 3 * n), dtype=np.int64)
    for k in range(first, last):
        status[k], residual[k], iterations[k] = cone_qp_kernel(
            A[k], c[k], mu[k], active[k], lam[k], tolerance, max_iterations, regularization, work, index
        )


def solve_cone_qp(
    A: Array,
    c: Array,
    mu: Array,
    *,
    active: NDArray[np.bool_] | None = None,
    warm: Array | None = None,
    regularization: float = 0.0,
    tolerance: float = DEFAULT_TOLERANCE,
    max_iterations: int = 60,
    n_threads: int = 1,
) -> ContactSolution:
    """Minimise 1/2 lam^T A lam + c^T lam over the friction cones, for a batch.

    Args:
        A: (B, 3 n, 3 n) symmetric, positive semi-definite. c: (B, 3 n).
        mu: (n,) or (B, n) friction coefficients, at least 0.
        active: (B, n); contacts that are not active get lam = 0. All if None.
        warm: (B, 3 n) impulses to start from; zero if None.
        regularization: added to A's diagonal (makes lam unique where A is singular).
        tolerance: on the natural map (`problem.cone_qp_residual`), in the unit of c.
        max_iterations: of the quick kernel; problems that reach it are tried again from an
            interior-point answer.
        n_threads: the batch is split over this many threads (the kernels release the GIL).

    Returns:
        `ContactSolution`; lam (B, 3 n) in the order [n.., t1 t2 ..].

    Raises:
        InputError: shapes that do not fit, or a negative mu.
    """
    A, c, mu, chosen, lam = check_batch(A, c, mu, active, warm)
    status = np.empty(len(c), dtype=np.uint8)
    residual, iterations = np.empty(len(c)), np.empty(len(c), dtype=np.int64)

    def part(first: int, last: int) -> None:
        cone_qp_batch(
            A, c, mu, chosen, lam, status, residual, iterations,
            tolerance, max_iterations, regularization, first, last,
        )  # fmt: skip

    over_threads(part, len(c), n_threads)
    work, index = qp_work(mu.shape[1])
    for k in np.flatnonzero(status == MAX_ITERATIONS).tolist():
        start = interior_start(A[k], c[k], mu[k], chosen[k], regularization)

        def attempt(warm: Array, limit: int, k: int = k) -> tuple[int, float, int]:
            return cone_qp_kernel(A[k], c[k], mu[k], chosen[k], warm, tolerance, limit, regularization, work, index)

        status[k], residual[k] = rescue_programme(start, attempt, lam[k], float(residual[k]))
    return ContactSolution(lam, status, residual, iterations)
