"""The polyhedral friction cone as a linear complementarity problem, solved by Lemke's algorithm.

With k directions d_j around the tangent plane (k even) and lam_t = sum_j beta_j d_j, for every contact

    0 <= lam_n  _|_  w_n >= 0
    0 <= beta_j _|_  d_j . w_t + gamma >= 0
    0 <= gamma  _|_  mu lam_n - sum_j beta_j >= 0                        w = A lam + b

(Stewart & Trinkle 1996; Anitescu & Potra 1997). The basis that Lemke's algorithm (`lemke`) ends in is
solved again from the problem's own numbers, so that errors gathered while pivoting do not stay in the
answer. With redundant contacts (four corners at rest: rank 6 of 12) pivoting can still end in a basis that
is singular to rounding, on a false ray, or turn in circles of rounding errors. Such problems are tried
again, see `second_try`, and the best answer found is kept.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tossid.kernels import fused_kernel
from tossid.physics.solvers.batches import check_batch, over_threads
from tossid.physics.solvers.lemke import basic_solution, lcp_matrix, lemke
from tossid.physics.solvers.problem import ACCEPTED_KKT_ERROR, Array, tangent_directions
from tossid.physics.solvers.workspace import INACCURATE, NOT_FINITE, SOLVED

_PROXIMAL = 1e-5
_PROXIMAL_STEPS = 20
_SWEEPS = 2000


class LcpSolution(NamedTuple):
    """Solved polyhedral problems; `status` holds `SolverStatus` values.

    lam (B, 3 n) [N s], status (B,) uint8, kkt_error (B,) [m/s], iterations (B,) pivots,
    beta (B, n, k) [N s], gamma (B, n) [m/s].
    """

    lam: Array
    status: NDArray[np.uint8]
    kkt_error: Array
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


@fused_kernel
def own_scale(A, i, n, largest):  # type: ignore[no-untyped-def]
    """a_i = trace(A_ii) / 3 of contact i, floored as in `problem.contact_scale`; largest: trace among contacts."""
    t = n + 2 * i
    a = max(A[i, i] + A[t, t] + A[t + 1, t + 1], 1e-12 * largest) / 3.0
    return a if a > 0.0 else 1.0


@fused_kernel
def largest_trace(A, active, n):  # type: ignore[no-untyped-def]
    """The largest trace(A_ii) of the active contacts."""
    largest = 0.0
    for i in range(n):
        if active[i]:
            largest = max(largest, A[i, i] + A[n + 2 * i, n + 2 * i] + A[n + 2 * i + 1, n + 2 * i + 1])
    return largest


@fused_kernel
def lcp_kkt_error_kernel(A, b, mu, directions, active, lam, beta, gamma):  # type: ignore[no-untyped-def]
    """The KKT error `problem.lcp_kkt_error` [m/s] over the active contacts."""
    n, k = beta.shape
    worst, largest = 0.0, largest_trace(A, active, n)
    for i in range(n):
        if not active[i]:
            continue
        t = n + 2 * i
        w0, w1, w2 = b[i], b[t], b[t + 1]
        for j in range(3 * n):
            w0 += A[i, j] * lam[j]
            w1 += A[t, j] * lam[j]
            w2 += A[t + 1, j] * lam[j]
        a = own_scale(A, i, n, largest)
        total = 0.0
        step = abs(min(a * lam[i], w0))
        for j in range(k):
            total += beta[i, j]
            step = max(step, abs(min(a * beta[i, j], directions[j, 0] * w1 + directions[j, 1] * w2 + gamma[i])))
        step = max(step, abs(min(gamma[i], a * (mu[i] * lam[i] - total))))
        if not step <= worst:
            worst = step
    return worst


@fused_kernel
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


@fused_kernel
def lcp_sweeps(A, b, mu, active, directions, lam, beta, gamma, tolerance):  # type: ignore[no-untyped-def]
    """Block Gauss-Seidel from lam = 0: one contact after another, exactly. Returns the KKT error [m/s]."""
    n, k = beta.shape
    size = k + 2
    M, q, T = np.empty((size, size)), np.empty(size), np.empty((size + 1, 2 * size + 2))
    basis, ties, chosen = np.empty(size, np.int64), np.empty(size, np.int64), np.zeros(1, np.int64)
    own, g, one, scale = np.empty((3, 3)), np.empty(3), np.empty(3), np.empty(1)
    own_beta, own_gamma, own_mu = np.empty((1, k)), np.empty(1), np.empty(1)
    rows = np.empty(3, np.int64)
    lam[:], beta[:], gamma[:] = 0.0, 0.0, 0.0
    kkt_error = math.inf
    for sweep in range(_SWEEPS):
        for i in range(n):
            if not active[i]:
                continue
            rows[0], rows[1], rows[2] = i, n + 2 * i, n + 2 * i + 1
            for r in range(3):
                g[r] = b[rows[r]]
                for j in range(3 * n):
                    g[r] += A[rows[r], j] * lam[j]
                for c in range(3):
                    own[r, c] = A[rows[r], rows[c]]
                    g[r] -= own[r, c] * lam[rows[c]]
            own_mu[0] = mu[i]
            a = (own[0, 0] + own[1, 1] + own[2, 2]) / 3.0
            scale[0] = 1.0 / math.sqrt(a) if a > 0.0 else 1.0
            if g[0] >= 0.0:
                one[:] = 0.0
                own_beta[:] = 0.0
                own_gamma[0] = 0.0
                for j in range(k):
                    own_gamma[0] = max(own_gamma[0], -(directions[j, 0] * g[1] + directions[j, 1] * g[2]))
            else:
                lcp_matrix(own, g, own_mu, directions, chosen, 1, 1, scale, M, q)
                lemke(M, q, size, 50 * size, T, basis, ties)
                unpack(T[:, 2 * size + 1], size, scale, chosen, 1, 1, directions, basis, one, own_beta, own_gamma)
            for r in range(3):
                lam[rows[r]] = one[r]
            for j in range(k):
                beta[i, j] = own_beta[0, j]
            gamma[i] = own_gamma[0]
        if sweep % 10 == 9:
            kkt_error = lcp_kkt_error_kernel(A, b, mu, directions, active, lam, beta, gamma)
            if kkt_error <= tolerance or not kkt_error < math.inf:
                break
    return kkt_error


@fused_kernel
def pivoted(  # type: ignore[no-untyped-def]
    A, b, mu, active, directions, chosen, m, lam, beta, gamma, tolerance, max_iterations, work, index
):
    """Lemke's algorithm on the m chosen contacts, its basis solved again. Returns (status, kkt_error, pivots)."""
    n, k = beta.shape
    size, rows, largest = m * (k + 2), n * (k + 2), largest_trace(A, active, n)
    basis, ties = index[0], index[1]
    T, M = work[:rows], work[rows : 2 * rows]
    x, q, scale = np.empty(size), np.empty(size), np.empty(m)
    for p in range(m):
        scale[p] = 1.0 / math.sqrt(own_scale(A, chosen[p], n, largest))
    lcp_matrix(A, b, mu, directions, chosen, m, n, scale, M, q)
    status, iterations = lemke(M, q, size, max_iterations, T, basis, ties)
    for i in range(size):
        x[i] = T[i, 2 * size + 1]
    unpack(x, size, scale, chosen, m, n, directions, basis, lam, beta, gamma)
    kkt_error = lcp_kkt_error_kernel(A, b, mu, directions, active, lam, beta, gamma)
    if status == SOLVED and kkt_error > 1e-3 * tolerance:
        basic_solution(M, q, size, basis, work, 2 * rows)
        for i in range(size):
            x[i] = work[2 * rows, i]
        unpack(x, size, scale, chosen, m, n, directions, basis, lam, beta, gamma)
        kkt_error = lcp_kkt_error_kernel(A, b, mu, directions, active, lam, beta, gamma)
    return status, kkt_error, iterations


@fused_kernel
def second_try(  # type: ignore[no-untyped-def]
    A, b, mu, active, directions, chosen, m, lam, beta, gamma, kkt_error, tolerance, max_iterations, work, index
):
    """What pivoting left, again; lam, beta, gamma and the KKT error [m/s], which is returned, only get better.

    Proximal steps: Lemke's algorithm with A + e a_i 1, which is regular, and b - e a_i lam of the step
    before; their fixed point solves the problem itself, and one step misses it by e a_i |change of lam|.
    Then block Gauss-Seidel, each contact on its own well-conditioned numbers.
    """
    n, k = beta.shape
    largest = largest_trace(A, active, n)
    held, shifted, weight = A.copy(), b.copy(), np.zeros(3 * n)
    for i in range(n):
        if active[i]:
            for r in (i, n + 2 * i, n + 2 * i + 1):
                weight[r] = _PROXIMAL * own_scale(A, i, n, largest)
                held[r, r] += weight[r]
    other, other_beta, other_gamma = np.zeros(3 * n), np.zeros((n, k)), np.zeros(n)
    for turn in range(_PROXIMAL_STEPS + 1):
        if turn < _PROXIMAL_STEPS:
            for r in range(3 * n):
                shifted[r] = b[r] - weight[r] * other[r]
            status, _, _ = pivoted(
                held, shifted, mu, active, directions, chosen, m, other, other_beta, other_gamma,
                tolerance, max_iterations, work, index,
            )  # fmt: skip
            found = lcp_kkt_error_kernel(A, b, mu, directions, active, other, other_beta, other_gamma)
        else:
            status = SOLVED
            found = lcp_sweeps(A, b, mu, active, directions, other, other_beta, other_gamma, tolerance)
        if not kkt_error <= found:
            kkt_error = found
            lam[:], beta[:], gamma[:] = other, other_beta, other_gamma
            if kkt_error <= tolerance:
                break
        if status != SOLVED:  # no step to go on from
            other[:] = 0.0
    return kkt_error


@fused_kernel
def lcp_kernel(  # type: ignore[no-untyped-def]
    A, b, mu, active, directions, lam, beta, gamma, tolerance, max_iterations, work, index
):
    """Solve one problem; lam (3 n,), beta (n, k), gamma (n,) receive the answer.

    directions: (k, 2), from `tangent_directions`. work, index: from `lcp_work(n, k)`.

    Returns:
        (status, kkt_error [m/s], pivots). A problem that is not solved has the status that pivoting
        ended with, and the best answer found.
    """
    n = beta.shape[0]
    chosen = index[2]
    m, total = np.int64(0), 0.0  # not a literal, of which numba would compile a second version
    for i in range(n):
        if active[i]:
            chosen[m] = i
            m += 1
            total += b[i] + b[n + 2 * i] + b[n + 2 * i + 1] + mu[i]
    if not abs(total + largest_trace(A, active, n)) < math.inf:
        lam[:], beta[:], gamma[:] = 0.0, 0.0, 0.0
        return NOT_FINITE, math.inf, 0
    status, kkt_error, iterations = pivoted(
        A, b, mu, active, directions, chosen, m, lam, beta, gamma, tolerance, max_iterations, work, index
    )
    if status != SOLVED or not kkt_error <= tolerance:
        kkt_error = second_try(
            A, b, mu, active, directions, chosen, m, lam, beta, gamma, kkt_error, tolerance, max_iterations, work, index
        )
    if kkt_error <= tolerance:
        return SOLVED, kkt_error, iterations
    return INACCURATE if status == SOLVED else status, kkt_error, iterations


@fused_kernel
def lcp_batch(  # type: ignore[no-untyped-def]
    A,
    b,
    mu,
    active,
    directions,
    lam,
    beta,
    gamma,
    status,
    kkt_error,
    iterations,
    tolerance,
    max_iterations,
    first,
    last,
):
    """`lcp_kernel` on problems first..last-1 of a batch, one after another."""
    size = mu.shape[1] * (directions.shape[0] + 2)
    work = np.empty((2 * size + 1, 2 * size + 2))
    index = np.empty((3, size + mu.shape[1]), dtype=np.int64)
    for k in range(first, last):
        status[k], kkt_error[k], iterations[k] = lcp_kernel(
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
    tolerance: float = ACCEPTED_KKT_ERROR,
    max_iterations: int = 2000,
    n_threads: int = 1,
) -> LcpSolution:
    """Solve a batch of contact problems with the polyhedral friction cone.

    Args:
        A: (B, 3 n, 3 n) [1/kg] Delassus matrices, symmetric, positive semi-definite.
        b: (B, 3 n) [m/s]. mu: (n,) or (B, n) friction coefficients, at least 0.
        active: (B, n); contacts that are not active get lam = 0. All if None.
        n_directions: k, even and at least 4.
        tolerance: [m/s] on the complementarity error (`problem.lcp_kkt_error`).
        max_iterations: pivots; a problem that reaches it is tried again another way (`second_try`).
        n_threads: the batch is split over this many threads (the kernels release the GIL).

    Raises:
        InputError: shapes that do not fit, a negative mu, or an odd number of directions.
    """
    directions = tangent_directions(n_directions)
    A, b, mu, chosen, lam = check_batch(A, b, mu, active, None)
    count, n = mu.shape
    beta, gamma = np.zeros((count, n, n_directions)), np.zeros((count, n))
    status = np.empty(count, dtype=np.uint8)
    kkt_error, iterations = np.empty(count), np.empty(count, dtype=np.int64)

    def part(first: int, last: int) -> None:
        lcp_batch(
            A, b, mu, chosen, directions, lam, beta, gamma, status, kkt_error, iterations,
            tolerance, max_iterations, first, last,
        )  # fmt: skip

    over_threads(part, count, n_threads)
    return LcpSolution(lam, status, kkt_error, iterations, beta, gamma)
