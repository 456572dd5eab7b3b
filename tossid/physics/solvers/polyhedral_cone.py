"""The polyhedral friction cone of one time step, as a linear complementarity problem that Lemke's algorithm solves.

With k directions d_j around the tangent plane (k even) and lam_t = sum_j beta_j d_j, for every contact

    0 <= lam_n   _|_  w_n >= 0
    0 <= beta_j  _|_  d_j . w_t + gamma >= 0
    0 <= gamma   _|_  mu lam_n - sum_j beta_j >= 0                        w = A lam + b

(Stewart & Trinkle 1996; Anitescu & Potra 1997). With z = (lam_n, beta, gamma) of each contact in turn this is
0 <= z _|_ M z + q >= 0. Complementary pivoting with a lexicographic ratio test cannot cycle (Cottle, Pang & Stone, "The
Linear Complementarity Problem", 1992, 4.4 and 4.9); it ends at a solution or on a ray. Rounding may still end it in a
basis that is none, where contacts are redundant (four corners at rest: rank 6 of 12). The diagonal of M is then raised
a little, which makes a singular M regular. What is not solved then either counts as unsolved.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from tossid.errors import InputError
from tossid.kernels import fused_part_kernel, implements
from tossid.physics.solvers.blocks import lu_solve
from tossid.physics.solvers.registry import solve_contact
from tossid.physics.solvers.workspace import (
    INACCURATE,
    INFEASIBLE,
    LAM,
    MAX_ITERATIONS,
    MU,
    SCALE,
    SOLVED,
    B,
    W,
    contact_scales,
    multiply,
)

RIDGES = (0.0, 1e-9, 1e-7)
"""By which the diagonal of M, near 1, is raised, one after the other until the KKT error is within its tolerance."""
SMALLEST_PIVOT = 1e-10
"""Entries of the entering column that are smaller limit nothing."""
TIE = 1e-11
"""Ratios that differ by less, relative and absolute, tie."""


class PolyhedralCone(NamedTuple):
    """The polyhedral friction cone of Stewart and Trinkle, solved as an LCP by Lemke's algorithm.

    Attributes:
        n_directions: of the cone, an even number from 4.
        max_iterations: pivots.
    """

    n_directions: int = 8
    max_iterations: int = 2000

    def check(self, relaxed: bool) -> None:
        """Refuse an odd number of directions, and the convex relaxation of Coulomb's law.

        Args:
            relaxed: whether contacts near the ground follow that relaxation.

        Raises:
            InputError: n_directions is odd or below 4, or `relaxed`.
        """
        if self.n_directions < 4 or self.n_directions % 2:
            raise InputError(f"n_directions is {self.n_directions}, expected an even number from 4")
        if relaxed:
            raise InputError("the convex relaxation of Coulomb's law ('lifting') needs the solver ExactCone()")


@implements(solve_contact, PolyhedralCone)
def _solve(solver, A, V, index, n, tolerance):  # type: ignore[no-untyped-def]
    return solve_polyhedral(A, V, n, tolerance, solver.n_directions, solver.max_iterations)


@fused_part_kernel
def solve_polyhedral(A, V, n, tolerance, n_directions, max_pivots):  # type: ignore[no-untyped-def]
    """Solve the contact-major problem A, V[B], V[MU] of n contacts into V[LAM]; (status, KKT error [m/s])."""
    size = n * (n_directions + 2)
    M, q, basis, values = np.zeros((size, size)), np.zeros(size), np.empty(size, np.int64), np.empty(size)
    axes = np.zeros((n_directions + 1, 3))  # the normal, then the directions around it
    axes[0, 0] = 1.0
    for j in range(n_directions):
        angle = 2.0 * math.pi * j / n_directions
        axes[1 + j, 1], axes[1 + j, 2] = math.cos(angle), math.sin(angle)
    contact_scales(A, V, n)
    lcp_matrix(A, V, n, axes, M, q)
    z, best, least, status, before = np.zeros(size), np.zeros(size), math.inf, MAX_ITERATIONS, 0.0
    for ridge in RIDGES:
        for i in range(size):
            M[i, i] += ridge - before
            z[i] = 0.0
        before = ridge
        ended = lemke(M, q, max_pivots, basis, values)
        for row in range(size):
            if size <= basis[row] < 2 * size:
                z[basis[row] - size] = max(values[row], 0.0)
        write_impulses(A, V, n, axes, z)
        kkt_error = complementarity_error(V, n, axes, z)
        if kkt_error <= tolerance:
            return SOLVED, kkt_error
        if kkt_error < least:
            least, best[:] = kkt_error, z
            status = INACCURATE if ended == SOLVED else ended
    write_impulses(A, V, n, axes, best)
    return status, least


@fused_part_kernel
def write_impulses(A, V, n, axes, z):  # type: ignore[no-untyped-def]
    """Write the contacts' impulses at z into V[LAM], and their velocities into V[W]."""
    n_axes = axes.shape[0]
    for r in range(3 * n):
        V[LAM, r] = 0.0
    for i in range(n):
        for a in range(n_axes):
            impulse = z[i * (n_axes + 1) + a] / math.sqrt(V[SCALE, i])
            for t in range(3):
                V[LAM, 3 * i + t] += impulse * axes[a, t]
    multiply(A, V, LAM, W, n)


@fused_part_kernel
def lcp_matrix(A, V, n, axes, M, q):  # type: ignore[no-untyped-def]
    """M and q of 0 <= z _|_ M z + q >= 0, scaled.

    Contact i's impulses are measured in 1 / sqrt(a_i) and its velocities in sqrt(a_i), a_i = V[SCALE, i], so that the
    diagonal of M is near 1.
    """
    n_axes = axes.shape[0]
    block = n_axes + 1
    for i in range(n):
        for a in range(n_axes):
            row, own = i * block + a, 1.0 / math.sqrt(V[SCALE, i])
            for t in range(3):
                q[row] += own * axes[a, t] * V[B, 3 * i + t]
            for h in range(n):
                for c in range(n_axes):
                    s = 0.0
                    for t in range(3):
                        for u in range(3):
                            s += axes[a, t] * A[3 * i + t, 3 * h + u] * axes[c, u]
                    M[row, h * block + c] = own / math.sqrt(V[SCALE, h]) * s
        last = i * block + n_axes  # of gamma
        M[last, i * block] = V[MU, i]
        for a in range(1, n_axes):
            M[i * block + a, last], M[last, i * block + a] = 1.0, -1.0


@fused_part_kernel
def complementarity_error(V, n, axes, z):  # type: ignore[no-untyped-def]
    """The KKT error of the polyhedral cone (`problem`) [m/s], at z and the velocities V[W]."""
    n_axes, worst = axes.shape[0], 0.0
    for i in range(n):
        first, unit = i * (n_axes + 1), math.sqrt(V[SCALE, i])
        slip, total = unit * z[first + n_axes], 0.0  # gamma [m/s], and the sum of beta over its unit
        for a in range(n_axes):
            w = 0.0 if a == 0 else slip
            total += 0.0 if a == 0 else z[first + a]
            for t in range(3):
                w += axes[a, t] * V[W, 3 * i + t]
            step = abs(min(unit * z[first + a], w))
            if not step <= worst:
                worst = step
        step = abs(min(slip, unit * (V[MU, i] * z[first] - total)))
        if not step <= worst:
            worst = step
    return worst


@fused_part_kernel
def lemke(M, q, max_pivots, basis, values):  # type: ignore[no-untyped-def]
    """Lemke's algorithm on w = M z + q, 0 <= w _|_ z >= 0, with the artificial variable z_0 in every row.

    The tableau is w - M z - z_0 1 = q. basis[i] becomes the variable of row i (w_i is i, z_i is size + i, z_0 is
    2 size), and values[i] its value, solved for from M and q again: rounding that gathered in the tableau is not in it.
    """
    size = q.shape[0]
    last, row = 2 * size + 1, 0
    T, ties = np.zeros((size + 1, 2 * size + 2)), np.empty(size, np.int64)
    for i in range(size):
        for j in range(size):
            T[i, size + j] = -M[i, j]
        T[i, i], T[i, 2 * size], T[i, last] = 1.0, -1.0, q[i]
        basis[i], values[i] = i, q[i]
        if q[i] < q[row]:
            row = i
    if not q[row] < 0.0:
        return SOLVED
    status, enter = MAX_ITERATIONS, 2 * size
    for _ in range(max_pivots):
        pivot(T, row, enter)
        left = basis[row]
        basis[row] = enter
        if left == 2 * size:
            status = SOLVED
            break
        enter = left + size if left < size else left - size
        row = leaving_row(T, enter, basis, ties)
        if row < 0:
            status = INFEASIBLE
            break
    for i in range(size):  # C x = q, column i of C that of row i's variable in w - M z - z_0 1
        variable, T[size, i] = basis[i], q[i]
        for j in range(size):
            if variable < size:
                T[j, i] = 1.0 if j == variable else 0.0
            else:
                T[j, i] = -M[j, variable - size] if variable < 2 * size else -1.0
    lu_solve(T, 0, size, size)
    for i in range(size):
        values[i] = T[size, i]
    return status


@fused_part_kernel
def leaving_row(T, enter, basis, ties):  # type: ignore[no-untyped-def]
    """Row of the lexicographic ratio test in column `enter`, or -1 if nothing limits it (a ray).

    The least T[i, last] / T[i, enter] over positive T[i, enter]; ties go to the artificial variable before all, then
    to the least T[i, j] / T[i, enter], column j after column.
    """
    size = basis.shape[0]
    count, last, best = 0, 2 * size + 1, math.inf
    for i in range(size):
        if T[i, enter] > SMALLEST_PIVOT:
            best = min(best, max(T[i, last], 0.0) / T[i, enter])
    limit = best + TIE * (1.0 + best)
    for i in range(size):
        if T[i, enter] > SMALLEST_PIVOT and max(T[i, last], 0.0) / T[i, enter] <= limit:
            if basis[i] == 2 * size:
                return i
            ties[count] = i
            count += 1
    if count == 0:
        return -1
    column = 0
    while count > 1 and column < size:
        best = math.inf
        for t in range(count):
            best = min(best, T[ties[t], column] / T[ties[t], enter])
        limit, kept = best + TIE * (1.0 + abs(best)), 0
        for t in range(count):
            if T[ties[t], column] / T[ties[t], enter] <= limit:
                ties[kept] = ties[t]
                kept += 1
        count = kept
        column += 1
    return ties[0]


@fused_part_kernel
def pivot(T, row, enter):  # type: ignore[no-untyped-def]
    """Bring column `enter` into the basis at `row`: Gauss-Jordan elimination of the tableau's column."""
    inverse = 1.0 / T[row, enter]
    for j in range(T.shape[1]):
        T[row, j] *= inverse
    T[row, enter] = 1.0
    for i in range(T.shape[0] - 1):
        factor = T[i, enter]
        if i != row and factor != 0.0:
            for j in range(T.shape[1]):
                T[i, j] -= factor * T[row, j]
            T[i, enter] = 0.0
