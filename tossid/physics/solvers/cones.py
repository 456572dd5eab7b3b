"""The round friction cone of one time step: its contact law, and the cone programme.

Both are problems in the impulses lam and the velocities w = A lam + b (`problem`): the exact cone, which is not convex,
and the cone programme min over the cones of 1/2 lam^T A lam + b^T lam, which is. Two moves alternate:

1. a sweep of projected Gauss-Seidel, each contact solved exactly (`block_cone`, `block_qp`). It tells open, sticking
   and slipping contacts apart;
2. a Newton step on the manifold that this names (`newton_step`): lam_i = 0 where open, free where sticking, s (1, mu u)
   where slipping; put back into the cones, and taken if the KKT error falls or, of the programme, the objective.

Of the programme both can only lower the objective: the first converges from anywhere, the second quadratically at the
end, also where A is singular (four corners on a plane): redundant directions stay where the sweep put them. Of the
exact cone, the Newton step is tried first from a warm start: a body that slides or rests on needs nothing else. Where
the two moves stall there, the problem is solved as a sequence of cone programmes.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from tossid.kernels import fused_inlined_kernel, fused_lean_kernel, fused_part_kernel, implements
from tossid.physics.solvers.blocks import block_cone, block_qp
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
    newton_step,
    shift,
    velocity_without,
)

QUICK = 0.1
"""A Newton step that lowers the KKT error to this share is followed by another, without a sweep."""


class ExactCone(NamedTuple):
    """The exact friction cone with maximum dissipation, tried again from convex programmes.

    Attributes:
        max_iterations: of the two moves, each time that they are tried.
        programmes: cone programmes that a problem is tried again from.
    """

    max_iterations: int = 40
    programmes: int = 8


class ConeProgramme(NamedTuple):
    """The cone programme, in whose place of b stands its linear term.

    Attributes:
        max_iterations: of the two moves. Nearly all programmes need fewer than ten, some that are degenerate hundreds.
    """

    max_iterations: int = 1000


@fused_inlined_kernel
def cone_error(V, lam, w, m):  # type: ignore[no-untyped-def]
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


@fused_lean_kernel
def programme_error(V, lam, w, m):  # type: ignore[no-untyped-def]
    """The KKT error of the programme at V[lam], V[w]: the largest a_i |lam_i - P_i(lam_i - w_i / a_i)|."""
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


@fused_inlined_kernel
def kkt_error_at(V, lam, w, m, exact):  # type: ignore[no-untyped-def]
    """The KKT error of the exact cone or of the programme."""
    return cone_error(V, lam, w, m) if exact else programme_error(V, lam, w, m)


@fused_inlined_kernel
def objective(V, lam, w, m):  # type: ignore[no-untyped-def]
    """Twice the programme's objective, lam . (w + b)."""
    value = 0.0
    for j in range(3 * m):
        value += V[lam, j] * (V[w, j] + V[B, j])
    return value


@fused_inlined_kernel
def cone_state(V, index, m):  # type: ignore[no-untyped-def]
    """The states that the exact cone's error names at V[LAM]; False if a Newton step cannot reach them from there."""
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
def sweep(A, V, index, m, exact):  # type: ignore[no-untyped-def]
    """One pass of block Gauss-Seidel, w = A lam + b kept up; V[LAM], V[W] and the states are brought up to date.

    Each contact in turn is solved exactly for g_i = w_i - A_ii lam_i.
    """
    for i in range(m):
        k, mu = 3 * i, V[MU, i]
        g0, g1, g2 = velocity_without(A, V, k)
        u1, u2 = V[LAM, k + 1], V[LAM, k + 2]
        if exact:
            index[KIND, i], x0, x1, x2 = block_cone(A, k, g0, g1, g2, mu, u1, u2)
        else:
            index[KIND, i], x0, x1, x2 = block_qp(A, k, g0, g1, g2, mu, u1, u2)
        shift(A, V, k, x0, x1, x2, m)


@fused_lean_kernel
def solve_cones(A, V, index, m, tolerance, max_iterations, exact):  # type: ignore[no-untyped-def]
    """Solve the contact-major problem A, V[B], V[MU] in place of V[LAM], the warm start: exact cone, or programme.

    Returns:
        (status, KKT error [m/s]).
    """
    contact_scales(A, V, m)
    multiply(A, V, LAM, W, m)
    kkt_error = kkt_error_at(V, LAM, W, m, exact)
    if kkt_error <= tolerance:
        return SOLVED, kkt_error
    quick = exact and m > 1
    for _ in range(max_iterations):
        quick = quick and cone_state(V, index, m)
        if not quick:
            sweep(A, V, index, m, exact)
            kkt_error = kkt_error_at(V, LAM, W, m, exact)
            if kkt_error <= tolerance:  # of velocities that sweeps kept up; so also of these anew
                multiply(A, V, LAM, W, m)
                kkt_error = kkt_error_at(V, LAM, W, m, exact)
                if kkt_error <= tolerance:
                    return SOLVED, kkt_error
            if not kkt_error < math.inf:
                return NOT_FINITE, math.inf
            if exact and m == 1:
                continue
        size = newton_step(A, V, index, m, exact)
        value, length, taken, trial_error = 0.0 if exact else objective(V, LAM, W, m), 1.0, False, kkt_error
        for attempt in range(1 if quick else 3 if exact else 10):
            if attempt == 1:
                length = free_length(V, index, m, size)
            manifold_step(V, index, m, size, length)
            multiply(A, V, TRIAL, TRIAL_W, m)
            trial_error = kkt_error_at(V, TRIAL, TRIAL_W, m, exact)
            taken = trial_error < kkt_error or (not exact and objective(V, TRIAL, TRIAL_W, m) < value)
            if taken:
                break
            if attempt > 0:
                length *= 0.3
        quick = exact and trial_error < QUICK * kkt_error
        if taken:
            accept_trial(V, m)
            kkt_error = trial_error
            if kkt_error <= tolerance:
                return SOLVED, kkt_error
    return MAX_ITERATIONS, kkt_error


@implements(solve_contact, ConeProgramme)
def solve_programme(solver, A, V, index, n, tolerance):  # type: ignore[no-untyped-def]
    """The programme, by the two moves."""
    return solve_cones(A, V, index, n, tolerance, solver.max_iterations, False)


@implements(solve_contact, ExactCone)
def solve_exact(solver, A, V, index, n, tolerance):  # type: ignore[no-untyped-def]
    """The two moves and, for what they leave, `solve_again`."""
    status, kkt_error = solve_cones(A, V, index, n, tolerance, solver.max_iterations, True)
    if status == SOLVED:
        return status, kkt_error
    return solve_again(solver, A, V, index, n, tolerance, status, kkt_error)


@fused_part_kernel
def solve_again(solver, A, V, index, n, tolerance, status, kkt_error):  # type: ignore[no-untyped-def]
    """Impulses of a problem that was left at V[LAM] with this status and KKT error; (status, KKT error).

    It is tried again from the answers of cone programmes, b_n + mu |w_t| in place of b_n, held and renewed (Cadoux
    2009); the first, with b itself, is nearly always enough.
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
        solve_cones(A, V, index, n, tolerance, solver.max_iterations, False)
        for r in range(3 * n):
            start[r] = V[LAM, r]
        for i in range(n):
            V[B, 3 * i] = b[i]
        status, kkt_error = solve_cones(A, V, index, n, tolerance, solver.max_iterations, True)
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
