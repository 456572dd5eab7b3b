"""Lemke's algorithm: complementary pivoting for w = M z + q, 0 <= w _|_ z >= 0.

The ratio test is lexicographic, so that it cannot cycle (Cottle, Pang & Stone, "The Linear
Complementarity Problem", 1992, 4.4 and 4.9); it ends at a solution or on a ray.
"""

from __future__ import annotations

import math

from tossid.kernels import fused_kernel
from tossid.physics.solvers.blocks import lu_solve
from tossid.physics.solvers.workspace import INFEASIBLE, MAX_ITERATIONS, SOLVED

SMALLEST_PIVOT = 1e-10
"""Entries of the entering column that are smaller limit nothing."""
TIE = 1e-11
"""Ratios that differ by less, relative and absolute, tie."""


@fused_kernel
def leaving_row(T, size, enter, basis, ties):  # type: ignore[no-untyped-def]
    """Row of the lexicographic ratio test in column `enter`, or -1 if nothing limits it (a ray).

    The least T[i, last] / T[i, enter] over positive T[i, enter]; ties go to the least T[i, j] / T[i, enter], column j
    after column, and to the artificial variable before all.
    """
    last = 2 * size + 1
    count = 0
    best = math.inf
    for i in range(size):
        if T[i, enter] > SMALLEST_PIVOT:
            ratio = max(T[i, last], 0.0) / T[i, enter]
            if ratio < best:
                best = ratio
    if best == math.inf:
        return -1
    limit = best + TIE * (1.0 + best)
    for i in range(size):
        if T[i, enter] > SMALLEST_PIVOT and max(T[i, last], 0.0) / T[i, enter] <= limit:
            if basis[i] == 2 * size:
                return i
            ties[count] = i
            count += 1
    column = 0
    while count > 1 and column < size:
        best = math.inf
        for t in range(count):
            best = min(best, T[ties[t], column] / T[ties[t], enter])
        limit = best + TIE * (1.0 + abs(best))
        kept = 0
        for t in range(count):
            if T[ties[t], column] / T[ties[t], enter] <= limit:
                ties[kept] = ties[t]
                kept += 1
        count = kept
        column += 1
    return ties[0]


@fused_kernel
def pivot(T, size, row, enter):  # type: ignore[no-untyped-def]
    """Bring column `enter` into the basis at `row`: Gauss-Jordan elimination of the tableau's column."""
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


@fused_kernel
def lemke(M, q, size, max_iterations, T, basis, ties):  # type: ignore[no-untyped-def]
    """Lemke's algorithm on w = M z + q, 0 <= w _|_ z >= 0, with the artificial variable z_0 in every row.

    The tableau is w - M z - z_0 1 = q. basis[i] becomes the variable of row i (w_i is i, z_i is size + i, z_0 is
    2 size), and the tableau's last column its value.

    Returns:
        (status, pivots).
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


@fused_kernel
def basic_solution(M, q, size, basis, work, last):  # type: ignore[no-untyped-def]
    """work[last] = the values of the basic variables, from the problem's own M and q; other rows are overwritten.

    Solves C x = q, with column i of C that of row i's variable in w - M z - z_0 1.
    """
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
