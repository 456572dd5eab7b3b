"""The polyhedral friction problem of n contacts as a linear complementarity problem.

With k directions d_j around the tangent plane (k even) and lam_t = sum_j beta_j d_j, for every contact

    0 <= lam_n   _|_  w_n >= 0
    0 <= beta_j  _|_  d_j . w_t + gamma >= 0
    0 <= gamma   _|_  mu lam_n - sum_j beta_j >= 0                        w = A lam + b

(Stewart & Trinkle 1996; Anitescu & Potra 1997). With z = (lam_n, beta, gamma) of each contact in turn this is
0 <= z _|_ M z + q >= 0.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tossid.kernels import fused_kernel

Array = NDArray[np.float64]


class PolyhedralProblem(NamedTuple):
    """One problem; rows in the order of `problem`.

    Attributes:
        A: (3 n, 3 n) Delassus matrix [1/kg].
        b: (3 n,) [m/s].
        mu: (n,) friction coefficients.
        directions: (k, 2) d_j, unit vectors evenly around the tangent plane, the first along t1.
    """

    A: Array
    b: Array
    mu: Array
    directions: Array


class PolyhedralAnswer(NamedTuple):
    """What a solver finds.

    Attributes:
        lam: (3 n,) impulses [N s].
        beta: (n, k) their shares along the directions [N s].
        gamma: (n,) slip speeds, over the directions' grid [m/s].
    """

    lam: Array
    beta: Array
    gamma: Array


@fused_kernel
def make_answer(n, k):  # type: ignore[no-untyped-def]
    """An answer for n contacts and k directions, all zero."""
    return PolyhedralAnswer(np.zeros(3 * n), np.zeros((n, k)), np.zeros(n))


@fused_kernel
def own_scale(A, i, n, largest):  # type: ignore[no-untyped-def]
    """a_i = trace(A_ii) / 3 of contact i, at least 1e-12 of the largest; largest: trace among contacts."""
    t = n + 2 * i
    a = max(A[i, i] + A[t, t] + A[t + 1, t + 1], 1e-12 * largest) / 3.0
    return a if a > 0.0 else 1.0


@fused_kernel
def largest_trace(A, n):  # type: ignore[no-untyped-def]
    """The largest trace(A_ii)."""
    largest = 0.0
    for i in range(n):
        largest = max(largest, A[i, i] + A[n + 2 * i, n + 2 * i] + A[n + 2 * i + 1, n + 2 * i + 1])
    return largest


@fused_kernel
def polyhedral_kkt_error(problem, answer):  # type: ignore[no-untyped-def]
    """The KKT error of the polyhedral cone (`problem`) [m/s]."""
    A, b, mu, directions = problem
    lam, beta, gamma = answer
    n, k = beta.shape
    worst, largest = 0.0, largest_trace(A, n)
    for i in range(n):
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
def lcp_matrix(problem, scale, M, q):  # type: ignore[no-untyped-def]
    """M and q of 0 <= z _|_ M z + q >= 0 scaled.

    Contact i's impulses are measured in scale_i = 1 / sqrt(a_i) and its velocities in sqrt(a_i), so that the diagonal
    of M is near 1:

        M_ii = [[s s A_nn, s s A_n d,   0],        q_i = s (b_n, d^T b_t, 0)
                [s s d^T A_n, s s d^T A_tt d, 1],
                [mu, -1, 0]]
    """
    A, b, mu, directions = problem
    n, k = mu.shape[0], directions.shape[0]
    block = k + 2
    for i in range(n):
        row = i * block
        si = scale[i]
        q[row], q[row + k + 1] = b[i] * si, 0.0
        for j in range(k):
            q[row + 1 + j] = si * (directions[j, 0] * b[n + 2 * i] + directions[j, 1] * b[n + 2 * i + 1])
        for h in range(n):
            column = h * block
            s = si * scale[h]
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


@fused_kernel
def unpack(values, basis, size, scale, problem, answer):  # type: ignore[no-untyped-def]
    """The answer from the values of the basic variables of the scaled problem; negative ones are cut to 0.

    basis[row]: number of the variable, w first (0 to size - 1), then z, as in `lemke`.
    """
    directions, (lam, beta, gamma) = problem.directions, answer
    n, k = beta.shape
    block = k + 2
    lam[:] = 0.0
    beta[:] = 0.0
    gamma[:] = 0.0
    for row in range(size):
        variable = basis[row] - size
        if variable < 0 or variable >= size:
            continue
        i, place, value = variable // block, variable % block, max(values[row], 0.0)
        if place == 0:
            lam[i] = value * scale[i]
        elif place == k + 1:
            gamma[i] = value / scale[i]
        else:
            beta[i, place - 1] = value * scale[i]
            lam[n + 2 * i] += value * scale[i] * directions[place - 1, 0]
            lam[n + 2 * i + 1] += value * scale[i] * directions[place - 1, 1]


@fused_kernel
def contact_scaling(A, i, n, largest):  # type: ignore[no-untyped-def]
    """1 / sqrt(a_i): the unit of contact i's impulses in `lcp_matrix`."""
    return 1.0 / math.sqrt(own_scale(A, i, n, largest))
