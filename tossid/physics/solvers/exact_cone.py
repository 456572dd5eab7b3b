"""The exact friction cone of one time step: non-penetration and maximum dissipation.

    0 <= lam_n  _|_  w_n >= 0,   lam_t = argmin over |lam_t| <= mu lam_n of lam_t . w_t,   w = A lam + b

(Moreau 1988; Stewart & Trinkle 1996 before the cone becomes a polyhedron.) The problem is not
convex. Two moves alternate:

1. a sweep of projected Gauss-Seidel, each contact solved exactly (`block_cone`);
2. a Newton step on the equations of the state that the sweep found (open: lam_i = 0;
   sticking: w_i = 0; slipping: w_n = 0 and u x w_t = 0 with lam_i = s (1, mu u)), taken if
   the KKT error falls. From a warm start it is tried first: a body that slides or rests on
   needs nothing else.

Where they stall, the problem is solved as a sequence of convex cone programmes.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from tossid.kernels import fused_inlined_kernel, fused_lean_kernel, fused_part_kernel, implements
from tossid.physics.solvers.blocks import block_cone
from tossid.physics.solvers.cone_qp import qp_solve
from tossid.physics.solvers.newton import newton_step
from tossid.physics.solvers.registry import solve_contact
from tossid.physics.solvers.workspace import (
    KIND,
    LAM,
    MAX_ITERATIONS,
    MU,
    NOT_FINITE,
    OPEN,
    SCALE,
    SLIP,
    SOLVED,
    STICK,
    TRIAL,
    TRIAL_W,
    B,
    W,
    accept_trial,
    contact_scales,
    free_length,
    manifold_step,
    multiply,
    shift,
    velocity_without,
)

QUICK = 0.1
"""A Newton step that lowers the KKT error to this share is followed by another, without a sweep."""


@fused_inlined_kernel
def cone_natural_map(V, lam, w, m):  # type: ignore[no-untyped-def]
    """The KKT error of the exact cone (`problem`) [m/s] at V[lam], V[w].

    The largest over contacts of |min(a lam_n, w_n)| and |a lam_t - P(a lam_t - w_t)|, P the projection on the disk of
    radius mu a max(lam_n, 0).
    """
    worst = 0.0
    for i in range(m):
        k = 3 * i
        a, normal = V[SCALE, i], V[lam, k]
        x1, x2 = a * V[lam, k + 1] - V[w, k + 1], a * V[lam, k + 2] - V[w, k + 2]
        radius, reach = V[MU, i] * a * max(normal, 0.0), x1 * x1 + x2 * x2
        if reach > radius * radius:
            part = radius / math.sqrt(reach)
            x1, x2 = part * x1, part * x2
        d1, d2 = a * V[lam, k + 1] - x1, a * V[lam, k + 2] - x2
        step = max(abs(min(a * normal, V[w, k])), math.sqrt(d1 * d1 + d2 * d2))
        if not step <= worst:
            worst = step
    return worst


@fused_inlined_kernel
def cone_state(V, index, m):  # type: ignore[no-untyped-def]
    """The states that the natural map names at V[LAM]; False if a Newton step cannot reach them from there."""
    for i in range(m):
        k = 3 * i
        a, normal = V[SCALE, i], V[LAM, k]
        if a * normal <= V[W, k]:
            if normal > 0.0:
                return False
            index[KIND, i] = OPEN
            continue
        if normal <= 0.0:
            return False
        x1, x2 = a * V[LAM, k + 1] - V[W, k + 1], a * V[LAM, k + 2] - V[W, k + 2]
        radius = V[MU, i] * a * normal
        if x1 * x1 + x2 * x2 < radius * radius:
            index[KIND, i] = STICK
        else:
            index[KIND, i] = SLIP
            if radius > 0.0 and V[LAM, k + 1] == 0.0 and V[LAM, k + 2] == 0.0:
                return False
    return True


@fused_lean_kernel
def cone_sweep(A, V, index, m):  # type: ignore[no-untyped-def]
    """One pass of block Gauss-Seidel, w = A lam + b kept up; V[LAM], V[W] and the states are brought up to date.

    Each contact in turn is solved exactly for g_i = w_i - A_ii lam_i (`block_cone`).
    """
    for i in range(m):
        k = 3 * i
        g0, g1, g2 = velocity_without(A, V, k)
        index[KIND, i], x0, x1, x2 = block_cone(A, k, g0, g1, g2, V[MU, i], V[LAM, k + 1], V[LAM, k + 2])
        shift(A, V, k, x0, x1, x2, m)


@fused_lean_kernel
def cone_solve(A, V, index, m, tolerance, max_iterations):  # type: ignore[no-untyped-def]
    """Solve the contact-major problem A, V[B], V[MU] in place of V[LAM], the warm start.

    Returns:
        (status, KKT error [m/s], iterations).
    """
    contact_scales(A, V, m)
    multiply(A, V, LAM, W, m)
    kkt_error = cone_natural_map(V, LAM, W, m)
    if kkt_error <= tolerance:
        return SOLVED, kkt_error, 0
    quick = m > 1
    for iteration in range(1, max_iterations + 1):
        quick = quick and cone_state(V, index, m)
        if not quick:
            cone_sweep(A, V, index, m)
            kkt_error = cone_natural_map(V, LAM, W, m)
            if kkt_error <= tolerance:
                multiply(A, V, LAM, W, m)
                kkt_error = cone_natural_map(V, LAM, W, m)
                if kkt_error <= tolerance:
                    return SOLVED, kkt_error, iteration
            if not kkt_error < math.inf:
                return NOT_FINITE, math.inf, iteration
            if m == 1:
                continue
        size = newton_step(A, V, index, m, True)
        length = 1.0
        for attempt in range(1 if quick else 3):
            if attempt == 1:
                length = free_length(V, index, m, size)
            manifold_step(V, index, m, size, length)
            multiply(A, V, TRIAL, TRIAL_W, m)
            trial_error = cone_natural_map(V, TRIAL, TRIAL_W, m)
            if trial_error < kkt_error:
                break
            if attempt > 0:
                length *= 0.3
        quick = trial_error < QUICK * kkt_error
        if trial_error < kkt_error:
            accept_trial(V, m)
            kkt_error = trial_error
            if kkt_error <= tolerance:
                return SOLVED, kkt_error, iteration
    return MAX_ITERATIONS, kkt_error, max_iterations


class ExactCone(NamedTuple):
    """The exact friction cone with maximum dissipation , tried again from convex programmes.

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


@fused_part_kernel
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
