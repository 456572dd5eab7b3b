"""The cone programme: min over the friction cones of 1/2 lam^T A lam + c^T lam (convex).

It is the inner problem of the ContactNets loss (Pfrommer, Halm & Posa 2020, eq. 14 ff.).
Two moves alternate, and both can only lower the objective:

1. a sweep of block coordinate descent, each contact solved exactly (`block_qp`). It tells
   open, sticking and slipping contacts apart;
2. a Newton step on the manifold that this names: lam_i = 0 where open, free where sticking,
   s (1, mu u) on the cone's surface where slipping, with the surface's curvature; projected
   back, and taken if the objective or the KKT error falls.

The first converges from anywhere, the second quadratically at the end, also where A is
singular (four corners on a plane): redundant directions stay where the sweep put them.
"""

from __future__ import annotations

import math

from tossid.kernels import fused_kernel, fused_lean_kernel, fused_part_kernel
from tossid.parallel import over_threads
from tossid.physics.solvers.blocks import block_qp
from tossid.physics.solvers.newton import newton_step
from tossid.physics.solvers.problem import DEFAULT_TOLERANCE, Array, ContactSolution, check_batch, empty_solution
from tossid.physics.solvers.workspace import (
    KIND,
    LAM,
    MAX_ITERATIONS,
    MU,
    NOT_FINITE,
    SCALE,
    SOLVED,
    TOP,
    TRIAL,
    TRIAL_W,
    B,
    W,
    accept_trial,
    contact_scales,
    free_length,
    gather,
    gather_matrix,
    manifold_step,
    multiply,
    scatter,
    shift,
    velocity_without,
    work_arrays,
)

MOST_ITERATIONS = 1000
"""Sweeps, each with a Newton step. Nearly all programmes need fewer than ten, some that are degenerate hundreds."""


@fused_lean_kernel
def qp_kkt_error(V, lam, w, m):  # type: ignore[no-untyped-def]
    """The KKT error at V[lam], V[w]: the largest a_i |lam_i - P_i(lam_i - w_i / a_i)|."""
    worst = 0.0
    for i in range(m):
        k = 3 * i
        a, mu = V[SCALE, i], V[MU, i]
        x0, x1, x2 = V[lam, k] - V[w, k] / a, V[lam, k + 1] - V[w, k + 1] / a, V[lam, k + 2] - V[w, k + 2] / a
        tangent = math.sqrt(x1 * x1 + x2 * x2)
        if tangent > mu * x0 or x0 < 0.0:
            s = (x0 + mu * tangent) / (1.0 + mu * mu)
            if s <= 0.0 or tangent == 0.0:
                x0, x1, x2 = max(s, 0.0), 0.0, 0.0
            else:
                x0, x1, x2 = s, mu * s * x1 / tangent, mu * s * x2 / tangent
        d0, d1, d2 = V[lam, k] - x0, V[lam, k + 1] - x1, V[lam, k + 2] - x2
        step = a * math.sqrt(d0 * d0 + d1 * d1 + d2 * d2)
        if not step <= worst:
            worst = step
    return worst


@fused_lean_kernel
def qp_sweep(A, V, index, m):  # type: ignore[no-untyped-def]
    """One pass of block coordinate descent, w = A lam + c kept up; V[LAM], V[W] and the states are brought up to date.

    Each contact in turn takes its own minimum for g_i = w_i - A_ii lam_i (`block_qp`).
    """
    for i in range(m):
        k = 3 * i
        g0, g1, g2 = velocity_without(A, V, k)
        index[KIND, i], x0, x1, x2 = block_qp(A, k, g0, g1, g2, V[MU, i], V[LAM, k + 1], V[LAM, k + 2])
        shift(A, V, k, x0, x1, x2, m)


@fused_part_kernel
def qp_at_rest(V, m):  # type: ignore[no-untyped-def]
    """Whether lam = 0 solves the contact-major programme of V[B] and V[MU], whatever A is: c_n >= mu |c_t|."""
    for i in range(m):
        c1, c2 = V[B, 3 * i + 1], V[B, 3 * i + 2]
        if not V[B, 3 * i] >= V[MU, i] * math.sqrt(c1 * c1 + c2 * c2):
            return False
    return True


@fused_lean_kernel
def qp_solve(A, V, index, m, tolerance, max_iterations):  # type: ignore[no-untyped-def]
    """Solve the contact-major programme A, V[B], V[MU] in place of V[LAM], the warm start.

    Returns:
        (status, KKT error, iterations).
    """
    contact_scales(A, V, m)
    multiply(A, V, LAM, W, m)
    kkt_error = qp_kkt_error(V, LAM, W, m)
    if kkt_error <= tolerance:
        return SOLVED, kkt_error, 0
    for iteration in range(1, max_iterations + 1):
        qp_sweep(A, V, index, m)
        kkt_error = qp_kkt_error(V, LAM, W, m)
        if kkt_error <= tolerance:
            multiply(A, V, LAM, W, m)
            kkt_error = qp_kkt_error(V, LAM, W, m)
            if kkt_error <= tolerance:
                return SOLVED, kkt_error, iteration
        if not kkt_error < math.inf:
            return NOT_FINITE, math.inf, iteration
        size = newton_step(A, V, index, m, False)
        value = 0.0
        for j in range(3 * m):
            value += V[LAM, j] * (V[W, j] + V[B, j])
        length = 1.0
        for attempt in range(10):
            if attempt == 1:
                length = free_length(V, index, m, size)
            manifold_step(V, index, m, size, length)
            multiply(A, V, TRIAL, TRIAL_W, m)
            trial_value = 0.0
            for j in range(3 * m):
                trial_value += V[TRIAL, j] * (V[TRIAL_W, j] + V[B, j])
            trial_error = qp_kkt_error(V, TRIAL, TRIAL_W, m)
            if trial_value < value or trial_error < kkt_error:
                accept_trial(V, m)
                kkt_error = trial_error
                break
            if attempt > 0:
                length *= 0.3
        if kkt_error <= tolerance:
            return SOLVED, kkt_error, iteration
    return MAX_ITERATIONS, kkt_error, max_iterations


@fused_kernel
def cone_qp_batch(problems, out, tolerance, first, last):  # type: ignore[no-untyped-def]
    """Solve programmes first..last-1 of a batch, one after another, into `out`, a `ContactSolution`."""
    A, c, mu = problems
    n = mu.shape[1]
    work, index = work_arrays(n)
    local = work[TOP + 3 * n :]
    for k in range(first, last):
        total = gather(c[k], mu[k], out.lam[k], work)
        status, kkt_error = NOT_FINITE, math.inf
        if qp_at_rest(work, n):
            out.lam[k, :] = 0.0
            status, kkt_error = SOLVED, 0.0
        elif total < math.inf:
            gather_matrix(A[k], local, n)
            status, kkt_error, _ = qp_solve(local, work, index, n, tolerance, MOST_ITERATIONS)
            scatter(out.lam[k], work, n, status)
        else:
            out.lam[k, :] = 0.0
        out.status[k], out.kkt_error[k] = status, kkt_error


def solve_cone_qp(
    A: Array,
    c: Array,
    mu: Array,
    *,
    warm: Array | None = None,
    tolerance: float = DEFAULT_TOLERANCE,
    n_threads: int = 1,
) -> ContactSolution:
    """Minimise 1/2 lam^T A lam + c^T lam over the friction cones, for a batch.

    Args:
        A: (B, 3 n, 3 n) symmetric, positive semi-definite.
        c: (B, 3 n).
        mu: (n,) or (B, n) friction coefficients, at least 0.
        warm: (B, 3 n) impulses to start from; zero if None.
        tolerance: on the KKT error (`problem`), in the unit of c.
        n_threads: the batch is split over this many threads (the kernels release the GIL).

    Returns:
        The solutions; lam (B, 3 n) in the order [n.., t1 t2 ..].

    Raises:
        InputError: shapes that do not fit, or a negative mu.
    """
    problems, lam = check_batch(A, c, mu, warm)
    out = empty_solution(lam)

    def part(first: int, last: int) -> None:
        cone_qp_batch(problems, out, tolerance, first, last)

    over_threads(part, len(lam), n_threads)
    return out
