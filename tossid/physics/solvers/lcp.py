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
from tossid.physics.solvers.lemke import basic_solution, lemke
from tossid.physics.solvers.polyhedral_problem import (
    PolyhedralProblem,
    contact_scaling,
    largest_trace,
    lcp_matrix,
    make_answer,
    own_scale,
    polyhedral_kkt_error,
    unpack,
)
from tossid.physics.solvers.problem import Array
from tossid.physics.solvers.workspace import INACCURATE, NOT_FINITE, SOLVED

PROXIMAL_WEIGHT = 1e-5
"""e of the proximal steps: A + e a_i 1 in place of A."""
PROXIMAL_STEPS = 20
"""At most."""
SWEEPS = 2000
"""Of block Gauss-Seidel, at most."""


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
    """

    tableau: Array
    M: Array
    q: Array
    values: Array
    scale: Array
    basis: NDArray[np.int64]
    ties: NDArray[np.int64]


@fused_kernel
def lcp_scratch(n, k):  # type: ignore[no-untyped-def]
    """Scratch of `lcp_kernel` for n contacts with k directions, to be used again and again."""
    size = n * (k + 2)
    return LcpScratch(
        np.empty((size + 1, 2 * size + 2)), np.empty((size, size)), np.empty(size), np.empty(size), np.empty(n),
        np.empty(size, np.int64), np.empty(size, np.int64),
    )  # fmt: skip


@fused_kernel
def lcp_sweeps(problem, answer, tolerance):  # type: ignore[no-untyped-def]
    """Block Gauss-Seidel from lam = 0: one contact after another, exactly. Returns the KKT error [m/s].

    Contact i sees g_i = b_i + sum over j other than i of A_ij lam_j, and solves its own problem (A_ii, g_i, mu_i).
    """
    A, b, mu, directions = problem
    lam, beta, gamma = answer
    n, k = beta.shape
    size = k + 2
    scratch, scale = lcp_scratch(1, k), np.empty(1)
    own = PolyhedralProblem(np.empty((3, 3)), np.empty(3), np.empty(1), directions)
    own_A, g, own_mu, _ = own
    found = make_answer(1, k)
    M, q, T, basis, ties = scratch.M, scratch.q, scratch.tableau, scratch.basis, scratch.ties
    rows = np.empty(3, np.int64)
    lam[:], beta[:], gamma[:] = 0.0, 0.0, 0.0
    kkt_error = math.inf
    for sweep in range(SWEEPS):
        for i in range(n):
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
                lcp_matrix(own, scale, M, q)
                lemke(M, q, size, 50 * size, T, basis, ties)
                unpack(T[:, 2 * size + 1], basis, size, scale, own, found)
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
def pivoted(problem, answer, tolerance, max_iterations, scratch):  # type: ignore[no-untyped-def]
    """Lemke's algorithm, its basis solved again.

    Returns:
        (status, KKT error [m/s], pivots).
    """
    n, k = answer.beta.shape
    size, largest = n * (k + 2), largest_trace(problem.A, n)
    T, M, q, values, scale, basis, ties = scratch
    for i in range(n):
        scale[i] = contact_scaling(problem.A, i, n, largest)
    lcp_matrix(problem, scale, M, q)
    status, iterations = lemke(M, q, size, max_iterations, T, basis, ties)
    for i in range(size):
        values[i] = T[i, 2 * size + 1]
    unpack(values, basis, size, scale, problem, answer)
    kkt_error = polyhedral_kkt_error(problem, answer)
    if status == SOLVED and kkt_error > 1e-3 * tolerance:
        right = T.shape[0] - 1
        basic_solution(M, q, size, basis, T, right)
        for i in range(size):
            values[i] = T[right, i]
        unpack(values, basis, size, scale, problem, answer)
        kkt_error = polyhedral_kkt_error(problem, answer)
    return status, kkt_error, iterations


@fused_kernel
def second_try(problem, answer, kkt_error, tolerance, max_iterations, scratch):  # type: ignore[no-untyped-def]
    """What pivoting left, again; the answer and its KKT error [m/s], which is returned, only get better.

    Proximal steps: Lemke's algorithm with A + e a_i 1, which is regular, and b - e a_i lam of the step
    before; their fixed point solves the problem itself, and one step misses it by e a_i |change of lam|.
    Then block Gauss-Seidel, each contact on its own well-conditioned numbers.
    """
    A, b, mu, directions = problem
    n, k = answer.beta.shape
    largest = largest_trace(A, n)
    held, shifted, weight = A.copy(), b.copy(), np.zeros(3 * n)
    for i in range(n):
        for r in (i, n + 2 * i, n + 2 * i + 1):
            weight[r] = PROXIMAL_WEIGHT * own_scale(A, i, n, largest)
            held[r, r] += weight[r]
    near, other = PolyhedralProblem(held, shifted, mu, directions), make_answer(n, k)
    for turn in range(PROXIMAL_STEPS + 1):
        if turn < PROXIMAL_STEPS:
            for r in range(3 * n):
                shifted[r] = b[r] - weight[r] * other.lam[r]
            status, _, _ = pivoted(near, other, tolerance, max_iterations, scratch)
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
    A, b, mu, _ = problem
    n = mu.shape[0]
    total = largest_trace(A, n)
    for i in range(n):
        total += b[i] + b[n + 2 * i] + b[n + 2 * i + 1] + mu[i]
    if not abs(total) < math.inf:
        answer.lam[:], answer.beta[:], answer.gamma[:] = 0.0, 0.0, 0.0
        return NOT_FINITE, math.inf, 0
    status, kkt_error, iterations = pivoted(problem, answer, tolerance, max_iterations, scratch)
    if status != SOLVED or not kkt_error <= tolerance:
        kkt_error = second_try(problem, answer, kkt_error, tolerance, max_iterations, scratch)
    if kkt_error <= tolerance:
        return SOLVED, kkt_error, iterations
    return INACCURATE if status == SOLVED else status, kkt_error, iterations
