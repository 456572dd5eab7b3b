"""The exact friction cone in the time stepper."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from tossid.kernels import fused_kernel, implements
from tossid.physics.solvers.cone import cone_solve
from tossid.physics.solvers.cone_qp import qp_solve
from tossid.physics.solvers.registry import solve_contact
from tossid.physics.solvers.workspace import LAM, MU, SOLVED, B, W, multiply


class ExactCone(NamedTuple):
    """The exact friction cone with maximum dissipation (`cone`), tried again from convex programmes.

    Attributes:
        max_iterations: of the quick solver, each time that it is tried.
        programmes: cone programmes that a problem is tried again from.
    """

    max_iterations: int = 40
    programmes: int = 8


@implements(solve_contact, ExactCone)
def solve_exact(solver, A, V, index, n, tolerance):  # type: ignore[no-untyped-def]
    """The quick solver and, for what it leaves, `solve_again`."""
    status, kkt_error, _ = cone_solve(A, V, index, n, tolerance, solver.max_iterations)
    if status == SOLVED:
        return status, kkt_error
    return solve_again(solver, A, V, index, n, tolerance, status, kkt_error)


@fused_kernel
def solve_again(solver, A, V, index, n, tolerance, status, kkt_error):  # type: ignore[no-untyped-def]
    """Impulses of a problem that the quick solver left at V[LAM] with this status and KKT error; (status, KKT error).

    It is tried again from the answers of convex cone programmes, c_n = b_n + mu |w_t| held and renewed (Cadoux 2009);
    the first, with c = b, is nearly always enough.
    """
    b, start, best = np.empty(n), np.zeros(3 * n), V[LAM, : 3 * n].copy()
    least = kkt_error
    for i in range(n):
        b[i] = V[B, 3 * i]
    for turn in range(solver.programmes):
        for i in range(n):
            slip = 0.0
            if turn > 0:
                slip = math.sqrt(V[W, 3 * i + 1] * V[W, 3 * i + 1] + V[W, 3 * i + 2] * V[W, 3 * i + 2])
            V[B, 3 * i] = b[i] + V[MU, i] * slip
        for r in range(3 * n):
            V[LAM, r] = start[r]
        qp_solve(A, V, index, n, tolerance, solver.max_iterations)
        for r in range(3 * n):
            start[r] = V[LAM, r]
        for i in range(n):
            V[B, 3 * i] = b[i]
        status, kkt_error, _ = cone_solve(A, V, index, n, tolerance, solver.max_iterations)
        if status == SOLVED:
            return status, kkt_error
        if kkt_error < least:
            least = kkt_error
            for r in range(3 * n):
                best[r] = V[LAM, r]
        for r in range(3 * n):
            V[LAM, r] = start[r]
        multiply(A, V, LAM, W, n)
    for r in range(3 * n):
        V[LAM, r] = best[r]
    return status, least
