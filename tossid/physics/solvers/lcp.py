"""The polyhedral friction cone as a linear complementarity problem, solved by Lemke's algorithm.

With k directions d_j around the tangent plane (k even) and lam_t = sum_j beta_j d_j, for every contact

    0 <= lam_n  _|_  w_n >= 0
    0 <= beta_j _|_  d_j . w_t + gamma >= 0
    0 <= gamma  _|_  mu lam_n - sum_j beta_j >= 0                        w = A lam + b

(Stewart & Trinkle 1996; Anitescu & Potra 1997). Lemke's algorithm is complementary pivoting with a
lexicographic ratio test, which cannot cycle (Cottle, Pang & Stone 1992, 4.4 and 4.9); it ends at a
solution or on a ray. The basis that it ends in is then solved again from the problem's own numbers,
so that errors gathered while pivoting do not stay in the answer.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tossid.physics.solvers.batches import check_batch, over_threads
from tossid.physics.solvers.blocks import lu_solve
from tossid.physics.solvers.problem import ACCEPTED_RESIDUAL, Array, tangent_directions
from tossid.physics.solvers.workspace import INACCURATE, INFEASIBLE, MAX_ITERATIONS, NOT_FINITE, SOLVED, jit

_PIVOT = 1e-10
_TIE = 1e-11


class LcpSolution(NamedTuple):
    """Solved polyhedral problems; `status` holds `SolverStatus` values.

    lam (B, 3 n) [N s], status (B,) uint8, residual (B,) [m/s], iterations (B,) pivots,
    beta (B, n, k) [N s], gamma (B, n) [m/s].
    """

    lam: Array
    status: NDArray[np.uint8]
    residual: Array
    iterations: NDArray[np.int64]
    beta: Array
    gamma: Array

    @property
    def unsolved(self) -> int:
        """How many problems of the batch met no tolerance."""
        return int(np.count_nonzero(self.status != SOLVED))


def lcp_work(n: int, k: int) -> tuple[Array, NDArray[np.int64]]:
    """Work arrays of `lcp_kernel` for n contacts with k directions, to be used again and again."""
    size = n * (k + 2)
    return np.empty((2 * size + 1, 2 * size + 2)), np.empty((3, size + n), dtype=np.int64)


@jit
def lcp_matrix(A, b, mu, directions, chosen, m, n, scale, M, q):  # type: ignore[no-untyped-def]
    """The scaled complementarity problem w = M z + q of the chosen contacts, z = (lam_n, beta, gamma) by contact.

    Contact i's impulses are measured in 1 / sqrt(a_i) and its velocities in sqrt(a_i): M has a diagonal near 1.
    """
    k = directions.shape[0]
    block = k + 2
    for p in range(m):
        i = chosen[p]
        row = p * block
        si = scale[p]
        q[row], q[row + k + 1] = b[i] * si, 0.0
        for j in range(k):
            q[row + 1 + j] = si * (directions[j, 0] * b[n + 2 * i] + directions[j, 1] * b[n + 2 * i + 1])
        for r in range(m):
            h = chosen[r]
            column = r * block
            s = si * scale[r]
            M[row, column] = s * A[i, h]
            for j in range(k):
                c, d = directions[j, 0], directions[j, 1]
                M[row, column + 1 + j] = s * (c * A[i, n + 2 * h] + d * A[i, n + 2 * h + 1])
                M[row + 1 + j, column] = s * (c * A[n + 2 * i, h] + d * A[n + 2 * i + 1, h])
                left = c * A[n + 2 * i, n + 2 * h] + d * A[n + 2 * i + 1, n + 2 * h]
                right = c * A[n + 2 * i, n + 2 * h + 1] + d * A[n + 2 * i + 1, n + 2 * h + 1]
                for g in range(k):
                    M[row + 1 + j, column + 1 + g] = s * (left * directions[g, 0] + right * directions[g, 1])
                M[row + 1 + j, column + k + 1], M[row + k + 1, column + 1 + j] = 0.0, 0.0
            M[row, column + k + 1], M[row + k + 1, column], M[row + k + 1, column + k + 1] = 0.0, 0.0, 0.0
        for j in range(k):
            M[row + 1 + j, row + k + 1], M[row + k + 1, row + 1 + j] = 1.0, -1.0
        M[row + k + 1, row] = mu[i]


@jit
def leaving_row(T, size, enter, basis, ties):  # type: ignore[no-untyped-def]
    """Row of the lexicographic ratio test in column `enter`, or -1 if nothing limits it (a ray)."""
    last = 2 * size + 1
    count = 0
    best = math.inf
    for i in range(size):
        if T[i, enter] > _PIVOT:
            ratio = max(T[i, last], 0.0) / T[i, enter]
            if ratio < best:
                best = ratio
    if best == math.inf:
        return -1
    limit = best + _TIE * (1.0 + best)
    for i in range(size):
        if T[i, enter] > _PIVOT and max(T[i, last], 0.0) / T[i, enter] <= limit:
            if basis[i] == 2 * size:
                return i
            ties[count] = i
            count += 1
    column = 0
    while count > 1 and column < size:
        best = math.inf
        for t in range(count):
            best = min(best, T[ties[t], column] / T[ties[t], enter])
        limit = best + _TIE * (1.0 + abs(best))
        kept = 0
        for t in range(count):
            if T[ties[t], column] / T[ties[t], enter] <= limit:
                ties[kept] = ties[t]
                kept += 1
        count = kept
        column += 1
    return ties[0]


@jit
def pivot(T, size, row, enter):  # type: ignore[no-untyped-def]
    """Bring column `enter` into the basis at `row`."""
    width = 2 * size + 2
    inverse = 1.0 / T[row, enter]
    for j in range(width):
        T[row, j] *= inverse
    T[row, enter] = 1.0
    for i in range(size):
        factor = T[i, enter]
        if i != row and factor != 0.0:
            for j in range(width):
                T[i, j] -= factor * T[row, j]
            T[i, enter] = 0.0


@jit
def lemke(M, q, size, max_iterations, T, basis, ties):  # type: ignore[no-untyped-def]
    """Lemke's algorithm on w = M z + q. Returns (status, pivots); basis[i] is the variable of row i

    (w_i is i, z_i is size + i, the artificial variable 2 size) and T's last column its value.
    """
    last = 2 * size + 1
    row, worst = -1, 0.0
    for i in range(size):
        for j in range(size):
            T[i, j] = 0.0
            T[i, size + j] = -M[i, j]
        T[i, i], T[i, 2 * size], T[i, last] = 1.0, -1.0, q[i]
        basis[i] = i
        if q[i] <= worst and (q[i] < worst or row < 0) and q[i] < 0.0:
            worst, row = q[i], i
    if row < 0:
        return SOLVED, 0
    enter = 2 * size
    for iteration in range(1, max_iterations + 1):
        pivot(T, size, row, enter)
        left = basis[row]
        basis[row] = enter
        if left == 2 * size:
            return SOLVED, iteration
        enter = left + size if left < size else left - size
        row = leaving_row(T, size, enter, basis, ties)
        if row < 0:
            return INFEASIBLE, iteration
    return MAX_ITERATIONS, max_iterations


@jit
def basic_solution(M, q, size, basis, work, last):  # type: ignore[no-untyped-def]
    """work[last] = the values of the basic variables, from the problem's own M and q; other rows are overwritten."""
    for i in range(size):
        work[last, i] = q[i]
        variable = basis[i]
        for j in range(size):
            if variable < size:
                work[j, i] = 1.0 if j == variable else 0.0
            elif variable < 2 * size:
                work[j, i] = -M[j, variable - size]
            else:
                work[j, i] = -1.0
    lu_solve(work, 0, size, last)


@jit
def lcp_residual_kernel(A, b, mu, directions, active, lam, beta, gamma):  # type: ignore[no-untyped-def]
    """The residual `problem.lcp_residual` [m/s] over the active contacts."""
    n, k = beta.shape
    worst, largest = 0.0, 0.0
    for i in range(n):
        if active[i]:
            largest = max(largest, A[i, i] + A[n + 2 * i, n + 2 * i] + A[n + 2 * i + 1, n + 2 * i + 1])
    for i in range(n):
        if not active[i]:
            continue
        t = n + 2 * i
        w0, w1, w2 = b[i], b[t], b[t + 1]
        for j in range(3 * n):
            w0 += A[i, j] * lam[j]
            w1 += A[t, j] * lam[j]
            w2 += A[t + 1, j] * lam[j]
        a = max(A[i, i] + A[t, t] + A[t + 1, t + 1], 1e-12 * largest) / 3.0
        if a == 0.0:
            a = 1.0
        total = 0.0
        step = abs(min(a * lam[i], w0))
        for j in range(k):
            total += beta[i, j]
            step = max(step, abs(min(a * beta[i, j], directions[j, 0] * w1 + directions[j, 1] * w2 + gamma[i])))
        step = max(step, abs(min(gamma[i], a * (mu[i] * lam[i] - total))))
        if not step <= worst:
            worst = step
    return worst


@jit
def unpack(x, size, scale, chosen, m, n, directions, basis, lam, beta, gamma):  # type: ignore[no-untyped-def]
    """lam, beta, gamma in the problem's units from the values x of the basic variables (negative ones cut to 0)."""
    k = directions.shape[0]
    block = k + 2
    lam[:] = 0.0
    beta[:] = 0.0
    gamma[:] = 0.0
    for row in range(size):
        variable = basis[row] - size
        if variable < 0 or variable >= size:
            continue
        p, place, value = variable // block, variable % block, max(x[row], 0.0)
        i = chosen[p]
        if place == 0:
            lam[i] = value * scale[p]
        elif place == k + 1:
            gamma[i] = value / scale[p]
        else:
            beta[i, place - 1] = value * scale[p]
            lam[n + 2 * i] += value * scale[p] * directions[place - 1, 0]
            lam[n + 2 * i + 1] += value * scale[p] * directions[place - 1, 1]


@jit
def lcp_kernel(  # type: ignore[no-untyped-def]
    A, b, mu, active, directions, lam, beta, gamma, tolerance, max_iterations, work, index
):
    """Solve one problem; lam (3 n,), beta (n, k), gamma (n,) receive the answer.

    directions: (k, 2), from `tangent_directions`. work, index: from `lcp_work(n, k)`.

    Returns:
        (status, residual [m/s], pivots).
    """
    n, k = beta.shape
    basis, ties, chosen = index[0], index[1], index[2]
    m = 0
    total = 0.0
    largest = 0.0
    for i in range(n):
        if active[i]:
            chosen[m] = i
            m += 1
            t = n + 2 * i
            total += b[i] + b[t] + b[t + 1] + mu[i]
            largest = max(largest, A[i, i] + A[t, t] + A[t + 1, t + 1])
    size = m * (k + 2)
    if not abs(total + largest) < math.inf:
        lam[:] = 0.0
        beta[:] = 0.0
        gamma[:] = 0.0
        return NOT_FINITE, math.inf, 0
    rows = n * (k + 2)
    T, M = work[:rows], work[rows : 2 * rows]
    x, q, scale = np.empty(size), np.empty(size), np.empty(m)
    for p in range(m):
        i = chosen[p]
        t = n + 2 * i
        a = max(A[i, i] + A[t, t] + A[t + 1, t + 1], 1e-12 * largest) / 3.0
        scale[p] = 1.0 / math.sqrt(a) if a > 0.0 else 1.0
    lcp_matrix(A, b, mu, directions, chosen, m, n, scale, M, q)
    status, iterations = lemke(M, q, size, max_iterations, T, basis, ties)
    for i in range(size):
        x[i] = T[i, 2 * size + 1]
    unpack(x, size, scale, chosen, m, n, directions, basis, lam, beta, gamma)
    residual = lcp_residual_kernel(A, b, mu, directions, active, lam, beta, gamma)
    if status == SOLVED and residual > 1e-3 * tolerance:
        basic_solution(M, q, size, basis, work, 2 * rows)
        for i in range(size):
            x[i] = work[2 * rows, i]
        unpack(x, size, scale, chosen, m, n, directions, basis, lam, beta, gamma)
        again = lcp_residual_kernel(A, b, mu, directions, active, lam, beta, gamma)
        residual = again
    if status == SOLVED and not residual <= tolerance:
        status = INACCURATE
    return status, residual, iterations


@jit
def lcp_batch(  # type: ignore[no-untyped-def]
    A, b, mu, active, directions, lam, beta, gamma, status, residual, iterations, tolerance, max_iterations, first, last
):
    """`lcp_kernel` on problems first..last-1 of a batch, one after another."""
    size = mu.shape[1] * (directions.shape[0] + 2)
    work = np.empty((2 * size + 1, 2 * size + 2))
    index = np.empty((3, size + mu.shape[1]), dtype=np.int64)
    for k in range(first, last):
        status[k], residual[k], iterations[k] = lcp_kernel(
            A[k], b[k], mu[k], active[k], directions, lam[k], beta[k], gamma[k],
            tolerance, max_iterations, work, index,
        )  # fmt: skip


def solve_lcp(
    A: Array,
    b: Array,
    mu: Array,
    *,
    active: NDArray[np.bool_] | None = None,
    n_directions: int = 8,
    tolerance: float = ACCEPTED_RESIDUAL,
    max_iterations: int = 2000,
    n_threads: int = 1,
) -> LcpSolution:
    """Solve a batch of contact problems with the polyhedral friction cone.

    Args:
        A: (B, 3 n, 3 n) [1/kg] Delassus matrices, symmetric, positive semi-definite.
        b: (B, 3 n) [m/s]. mu: (n,) or (B, n) friction coefficients, at least 0.
        active: (B, n); contacts that are not active get lam = 0. All if None.
        n_directions: k, even and at least 4.
        tolerance: [m/s] on the complementarity residual (`problem.lcp_residual`).
        max_iterations: pivots.
        n_threads: the batch is split over this many threads (the kernels release the GIL).

    Raises:
        InputError: shapes that do not fit, a negative mu, or an odd number of directions.
    """
    directions = tangent_directions(n_directions)
    A, b, mu, chosen, lam = check_batch(A, b, mu, active, None)
    count, n = mu.shape
    beta, gamma = np.zeros((count, n, n_directions)), np.zeros((count, n))
    status = np.empty(count, dtype=np.uint8)
    residual, iterations = np.empty(count), np.empty(count, dtype=np.int64)

    def part(first: int, last: int) -> None:
        lcp_batch(
            A, b, mu, chosen, directions, lam, beta, gamma, status, residual, iterations,
            tolerance, max_iterations, first, last,
        )  # fmt: skip

    over_threads(part, count, n_threads)
    return LcpSolution(lam, status, residual, iterations, beta, gamma)
