"""The polyhedral friction cone (`polyhedral_problem`), solved by Lemke's algorithm.

The basis that Lemke's algorithm (`lemke`) ends in is solved again from the problem's own numbers, so that rounding
errors gathered while pivoting do not stay in the answer. With redundant contacts (four corners at rest: rank 6 of 12)
pivoting can still end in a basis that is singular to rounding, on a false ray, or turn in circles of rounding errors.
Such problems are tried again, see `second_try`, and the best answer found is kept.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tossid.kernels import fused_kernel
from tossid.physics.solvers.batches import check_batch, over_threads
from tossid.physics.solvers.lemke import basic_solution, lemke
from tossid.physics.solvers.polyhedral_problem import (
    PolyhedralAnswer,
    PolyhedralProblem,
    contact_scaling,
    largest_trace,
    lcp_matrix,
    make_answer,
    own_scale,
    polyhedral_kkt_error,
    unpack,
)
from tossid.physics.solvers.problem import ACCEPTED_KKT_ERROR, Array, tangent_directions
from tossid.physics.solvers.workspace import INACCURATE, NOT_FINITE, SOLVED

PROXIMAL_WEIGHT = 1e-5
"""e of the proximal steps: A + e a_i 1 in place of A."""
PROXIMAL_STEPS = 20
SWEEPS = 2000
"""Of block Gauss-Seidel, at most."""


class LcpSolution(NamedTuple):
    """Solved polyhedral problems.

    Attributes:
        lam: (B, 3 n) impulses [N s].
        status: (B,) `SolverStatus` values.
        kkt_error: (B,) [m/s].
        iterations: (B,) pivots.
        beta: (B, n, k) shares of the impulses along the directions [N s].
        gamma: (B, n) slip speeds [m/s].
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


class LcpScratch(NamedTuple):
    """Scratch of `lcp_kernel` for `size` = n (k + 2) variables.

    Attributes:
        tableau: (size + 1, 2 size + 2) of Lemke's algorithm; its last row is a right-hand side.
        M: (size, size) matrix of the complementarity problem.
        q: (size,) its vector.
        values: (size,) of the basic variables.
        scale: (n,) unit of each contact's impulses.
        basis: (size,) number of each row's variable.
        ties: (size,) rows that tie in a ratio test.
        chosen: (n,) numbers of the active contacts.
    """

    tableau: Array
    M: Array
    q: Array
    values: Array
    scale: Array
    basis: NDArray[np.int64]
    ties: NDArray[np.int64]
    chosen: NDArray[np.int64]


@fused_kernel
def lcp_scratch(n, k):  # type: ignore[no-untyped-def]
    """Scratch of `lcp_kernel` for n contacts with k directions, to be used again and again."""
    size = n * (k + 2)
    return LcpScratch(
        np.empty((size + 1, 2 * size + 2)), np.empty((size, size)), np.empty(size), np.empty(size), np.empty(n),
        np.empty(size, np.int64), np.empty(size, np.int64), np.empty(n, np.int64),
    )  # fmt: skip


@fused_kernel
def lcp_sweeps(problem, answer, tolerance):  # type: ignore[no-untyped-def]
    """Block Gauss-Seidel from lam = 0: one contact after another, exactly. Returns the KKT error [m/s].

    Contact i sees g_i = b_i + sum over j other than i of A_ij lam_j, and solves its own problem (A_ii, g_i, mu_i).
    """
    A, b, mu, active, directions = problem
    lam, beta, gamma = answer
    n, k = beta.shape
    size = k + 2
    scratch, scale = lcp_scratch(1, k), np.empty(1)
    own = PolyhedralProblem(np.empty((3, 3)), np.empty(3), np.empty(1), np.ones(1, np.bool_), directions)
    own_A, g, own_mu, _, _ = own
    found = make_answer(1, k)
    M, q, T, basis, ties, chosen = (
        scratch.M, scratch.q, scratch.tableau, scratch.basis, scratch.ties, scratch.chosen
    )  # fmt: skip
    chosen[0] = 0
    rows = np.empty(3, np.int64)
    lam[:], beta[:], gamma[:] = 0.0, 0.0, 0.0
    kkt_error = math.inf
    for sweep in range(SWEEPS):
        for i in range(n):
            if not active[i]:
                continue
            rows[0], rows[1], rows[2] = i, n + 2 * i, n + 2 * i + 1
            for r in range(3):
                g[r] = b[rows[r]]
                for j in range(3 * n):
                    g[r] += A[rows[r], j] * lam[j]
                for c in range(3):
                    own_A[r, c] = A[rows[r], rows[c]]
                    g[r] -= own_A[r, c] * lam[rows[c]]
            own_mu[0] = mu[i]
            a = (own_A[0, 0] + own_A[1, 1] + own_A[2, 2]) / 3.0
            scale[0] = 1.0 / math.sqrt(a) if a > 0.0 else 1.0
            if g[0] >= 0.0:  # stays open; gamma is the slip speed that the directions see
                found.lam[:], found.beta[:], found.gamma[:] = 0.0, 0.0, 0.0
                for j in range(k):
                    found.gamma[0] = max(found.gamma[0], -(directions[j, 0] * g[1] + directions[j, 1] * g[2]))
            else:
                lcp_matrix(own, chosen, 1, scale, M, q)
                lemke(M, q, size, 50 * size, T, basis, ties)
                unpack(T[:, 2 * size + 1], basis, size, chosen, scale, own, found)
            for r in range(3):
                lam[rows[r]] = found.lam[r]
            for j in range(k):
                beta[i, j] = found.beta[0, j]
            gamma[i] = found.gamma[0]
        if sweep % 10 == 9:
            kkt_error = polyhedral_kkt_error(problem, answer)
            if kkt_error <= tolerance or not kkt_error < math.inf:
                break
    return kkt_error


@fused_kernel
def pivoted(problem, answer, m, tolerance, max_iterations, scratch):  # type: ignore[no-untyped-def]
    """Lemke's algorithm on the m contacts in scratch.chosen, its basis solved again.

    Returns:
        (status, KKT error [m/s], pivots).
    """
    n, k = answer.beta.shape
    size, largest = m * (k + 2), largest_trace(problem.A, problem.active, n)
    T, M, q, values, scale, basis, ties, chosen = scratch
    for p in range(m):
        scale[p] = contact_scaling(problem.A, chosen[p], n, largest)
    lcp_matrix(problem, chosen, m, scale, M, q)
    status, iterations = lemke(M, q, size, max_iterations, T, basis, ties)
    for i in range(size):
        values[i] = T[i, 2 * size + 1]
    unpack(values, basis, size, chosen, scale, problem, answer)
    kkt_error = polyhedral_kkt_error(problem, answer)
    if status == SOLVED and kkt_error > 1e-3 * tolerance:
        right = T.shape[0] - 1
        basic_solution(M, q, size, basis, T, right)
        for i in range(size):
            values[i] = T[right, i]
        unpack(values, basis, size, chosen, scale, problem, answer)
        kkt_error = polyhedral_kkt_error(problem, answer)
    return status, kkt_error, iterations


@fused_kernel
def second_try(problem, answer, m, kkt_error, tolerance, max_iterations, scratch):  # type: ignore[no-untyped-def]
    """What pivoting left, again; the answer and its KKT error [m/s], which is returned, only get better.

    Proximal steps: Lemke's algorithm with A + e a_i 1, which is regular, and b - e a_i lam of the step
    before; their fixed point solves the problem itself, and one step misses it by e a_i |change of lam|.
    Then block Gauss-Seidel, each contact on its own well-conditioned numbers.
    """
    A, b, mu, active, directions = problem
    n, k = answer.beta.shape
    largest = largest_trace(A, active, n)
    held, shifted, weight = A.copy(), b.copy(), np.zeros(3 * n)
    for i in range(n):
        if active[i]:
            for r in (i, n + 2 * i, n + 2 * i + 1):
                weight[r] = PROXIMAL_WEIGHT * own_scale(A, i, n, largest)
                held[r, r] += weight[r]
    near, other = PolyhedralProblem(held, shifted, mu, active, directions), make_answer(n, k)
    for turn in range(PROXIMAL_STEPS + 1):
        if turn < PROXIMAL_STEPS:
            for r in range(3 * n):
                shifted[r] = b[r] - weight[r] * other.lam[r]
            status, _, _ = pivoted(near, other, m, tolerance, max_iterations, scratch)
            found = polyhedral_kkt_error(problem, other)
        else:
            status = SOLVED
            found = lcp_sweeps(problem, other, tolerance)
        if not kkt_error <= found:
            kkt_error = found
            answer.lam[:], answer.beta[:], answer.gamma[:] = other.lam, other.beta, other.gamma
            if kkt_error <= tolerance:
                break
        if status != SOLVED:  # no step to go on from
            other.lam[:] = 0.0
    return kkt_error


@fused_kernel
def lcp_kernel(problem, answer, tolerance, max_iterations, scratch):  # type: ignore[no-untyped-def]
    """Solve one problem.

    Args:
        problem: `PolyhedralProblem`.
        answer: `PolyhedralAnswer`; receives the answer, or the best one found.
        tolerance: on the KKT error [m/s].
        max_iterations: pivots.
        scratch: from `lcp_scratch(n, k)`.

    Returns:
        (status, KKT error [m/s], pivots). A problem that is not solved has the status that pivoting ended with.
    """
    A, b, mu, active, _ = problem
    n = mu.shape[0]
    m, total = np.int64(0), 0.0  # not a literal, of which numba would compile a second version
    for i in range(n):
        if active[i]:
            scratch.chosen[m] = i
            m += 1
            total += b[i] + b[n + 2 * i] + b[n + 2 * i + 1] + mu[i]
    if not abs(total + largest_trace(A, active, n)) < math.inf:
        answer.lam[:], answer.beta[:], answer.gamma[:] = 0.0, 0.0, 0.0
        return NOT_FINITE, math.inf, 0
    status, kkt_error, iterations = pivoted(problem, answer, m, tolerance, max_iterations, scratch)
    if status != SOLVED or not kkt_error <= tolerance:
        kkt_error = second_try(problem, answer, m, kkt_error, tolerance, max_iterations, scratch)
    if kkt_error <= tolerance:
        return SOLVED, kkt_error, iterations
    return INACCURATE if status == SOLVED else status, kkt_error, iterations


@fused_kernel
def lcp_batch(problems, directions, out, tolerance, max_iterations, first, last):  # type: ignore[no-untyped-def]
    """`lcp_kernel` on problems first..last-1 of a batch, one after another, into `out`, an `LcpSolution`."""
    A, b, mu, active = problems
    scratch = lcp_scratch(mu.shape[1], directions.shape[0])
    for k in range(first, last):
        problem = PolyhedralProblem(A[k], b[k], mu[k], active[k], directions)
        answer = PolyhedralAnswer(out.lam[k], out.beta[k], out.gamma[k])
        out.status[k], out.kkt_error[k], out.iterations[k] = lcp_kernel(
            problem, answer, tolerance, max_iterations, scratch
        )


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
        b: (B, 3 n) [m/s].
        mu: (n,) or (B, n) friction coefficients, at least 0.
        active: (B, n); contacts that are not active get lam = 0. All if None.
        n_directions: k, even and at least 4.
        tolerance: [m/s] on the complementarity error (`problem.lcp_kkt_error`).
        max_iterations: pivots; a problem that reaches it is tried again another way (`second_try`).
        n_threads: the batch is split over this many threads (the kernels release the GIL).

    Returns:
        The solutions; lam (B, 3 n) [N s] in the order [n.., t1 t2 ..].

    Raises:
        InputError: shapes that do not fit, a negative mu, or an odd number of directions.
    """
    directions = tangent_directions(n_directions)
    problems, lam = check_batch(A, b, mu, active, None)
    count, n = problems.mu.shape
    out = LcpSolution(
        lam=lam,
        status=np.empty(count, dtype=np.uint8),
        kkt_error=np.empty(count),
        iterations=np.empty(count, dtype=np.int64),
        beta=np.zeros((count, n, n_directions)),
        gamma=np.zeros((count, n)),
    )

    def part(first: int, last: int) -> None:
        lcp_batch(problems, directions, out, tolerance, max_iterations, first, last)

    over_threads(part, count, n_threads)
    return out
