"""The contact problem of one step of a tree: which corners, their rows, the solution, its effect.

With u the velocity of the common centre of mass and xi = (spin, joint rates), see `articulated`,

    J_i v = u_i + tau_i . xi,     J_i M^-1 J_j^T = [same direction] / m + G_i . G_j,     G = L^-1 tau,  S = L L^T

Directions are the world's z (normal), x and y.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tossid.kernels import fused_kernel
from tossid.physics.articulated import X, back, contact_row, turned
from tossid.physics.forces import friction_of
from tossid.physics.solvers import cone_work, lcp_kernel, lcp_work, tangent_directions
from tossid.physics.solvers.cone import cone_solve
from tossid.physics.solvers.cone_qp import qp_solve
from tossid.physics.solvers.workspace import LAM, MU, SOLVED, B, W, multiply
from tossid.physics.system import System

Array = NDArray[np.float64]

MAX_ITERATIONS = 40
"""Of the quick solver, each time that it is tried."""
PROGRAMMES = 8
"""Cone programmes that a problem is tried again from."""
CLOSING_SPEED = 1.0
"""A corner joins the contact problem at once if it would touch within this speed [m/s]; others when they are hit."""
IMPACT_SPEED = 0.1
"""[m/s] at which a corner has to cross the ground for a step to be cut there."""
TOUCHING = 5e-5
"""Height [m] from which a corner that comes down at that speed strikes the ground."""
STRIKE = 1e-6
"""Length of a strike, over a frame's: an impulse, and no way."""
STEADY = 5e-3
"""[m/s] below which a touching corner goes neither up nor down: its slide then is that of the mean velocity."""
RESTING, QUIET = 100.0, 4
"""Speed [m/s] and spin [rad/s] in sum, over the solver's tolerance, below which a body in rigid contact is at rest
after so many steps. What gives way creeps on, and is followed."""
MOST_STRIKES = 64
"""In a frame; what comes after is as in whole steps."""
BOUNCE_SPEED = 0.02
"""Approach [m/s] below which restitution does not act."""
RECOVERY_SPEED = 0.02
"""[m/s] at which a corner that a toss starts with in rigid ground comes out of it."""
UNKNOWN = 1.0
"""Depth of a corner whose toss has not begun."""
TANGENTIAL = 1e-3
"""Slack of a compliant corner's tangential rows over that of its normal row: sigma of Castro et al."""


class Scratch(NamedTuple):
    """What a contact problem is built and solved in; corners in their own order, candidates contact-major."""

    height: Array  # (n_c,)
    sunk: Array  # (n_c,) how far the ground gives way below each: 0, or less where the toss began in it
    state: NDArray[np.int64]  # (n_c,) 0 far, 1 low, 2 candidate
    chosen: NDArray[np.int64]  # (n_c,) corner of each candidate
    place: Array  # (n_c, 3) from the base's origin, its axes
    tau: Array  # (n_c, 3, n_x) rows of every low corner: normal, t1, t2
    G: Array  # (n_x, 3 n_c) columns L^-1 tau of the candidates
    A: Array  # (3 n_c, 3 n_c) Delassus matrix
    warm: Array  # (n_c, 3) impulses of the last step
    y: Array  # (n_x,)
    V: Array
    solver_index: NDArray[np.int64]
    directions: Array  # (k, 2), k = 0 for the exact cone
    lcp_work: Array
    lcp_index: NDArray[np.int64]


def make_scratch(system: System, n_directions: int) -> Scratch:
    """Scratch of `system` with the exact cone (n_directions = 0) or a polyhedral one."""
    nc, nx, k = system.n_corners, system.nv - 3, n_directions
    lemke_work, lemke_index = lcp_work(nc, k) if k else (np.zeros((1, 1)), np.zeros((1, 1), dtype=np.int64))
    z = np.zeros
    return Scratch(
        z(nc),
        z(nc),
        z(nc, dtype=np.int64),
        z(nc, dtype=np.int64),
        z((nc, 3)),
        z((nc, 3, nx)),
        z((nx, 3 * nc)),
        z((3 * nc, 3 * nc)),
        z((nc, 3)),
        z(nx),
        *cone_work(nc),
        tangent_directions(k) if k else z((0, 2)),
        lemke_work,
        lemke_index,
    )


@fused_kernel
def _polyhedral(A, V, n, directions, tolerance, work, index):  # type: ignore[no-untyped-def]
    """The problem A, V[B], V[MU] with the polyhedral cone into V[LAM]; returns (status, kkt_error)."""
    k = directions.shape[0]
    A_, b, lam = np.empty((3 * n, 3 * n)), np.empty(3 * n), np.empty(3 * n)
    order = np.empty(3 * n, np.int64)
    for i in range(n):
        order[3 * i], order[3 * i + 1], order[3 * i + 2] = i, n + 2 * i, n + 2 * i + 1
    for r in range(3 * n):
        b[order[r]] = V[B, r]
        for r2 in range(3 * n):
            A_[order[r], order[r2]] = A[r, r2]
    beta, gamma = np.empty((n, k)), np.empty(n)
    status, kkt_error, _ = lcp_kernel(
        A_, b, V[MU, :n].copy(), np.ones(n, np.bool_), directions, lam, beta, gamma, tolerance, 2000, work, index
    )
    for r in range(3 * n):
        V[LAM, r] = lam[order[r]]
    return status, kkt_error


@fused_kernel
def above_ground(z, c, sunk, rigid, h):  # type: ignore[no-untyped-def]
    """Height of a corner at z over the ground as it is below it.

    Recorded states lie in the ground by their noise. Rigid contact would throw the object out within a step, with all
    that depth per step as its velocity; here it comes out at `RECOVERY_SPEED`. What gives way needs no such care.
    """
    if sunk[c] == UNKNOWN:
        sunk[c] = min(z, 0.0) if rigid else 0.0
    elif sunk[c] < 0.0:
        sunk[c] = min(sunk[c] + RECOVERY_SPEED * h, 0.0)
    return z - sunk[c]


@fused_kernel
def solve_exact(A, V, index, n, tolerance):  # type: ignore[no-untyped-def]
    """Impulses of the problem A, V[B], V[MU] into V[LAM], which holds the warm start; returns (status, kkt_error).

    What is not solved from there is tried again from the answers of convex cone programmes, c_n = b_n + mu |w_t|
    held and renewed (Cadoux 2009); the first, with c = b, is nearly always enough.
    """
    status, kkt_error, _ = cone_solve(A, V, index, n, tolerance, MAX_ITERATIONS)
    if status == SOLVED:
        return status, kkt_error
    b, start, best = np.empty(n), np.zeros(3 * n), V[LAM, : 3 * n].copy()
    least = kkt_error
    for i in range(n):
        b[i] = V[B, 3 * i]
    for turn in range(PROGRAMMES):
        for i in range(n):
            slip = 0.0
            if turn > 0:
                slip = math.sqrt(V[W, 3 * i + 1] * V[W, 3 * i + 1] + V[W, 3 * i + 2] * V[W, 3 * i + 2])
            V[B, 3 * i] = b[i] + V[MU, i] * slip
        for r in range(3 * n):
            V[LAM, r] = start[r]
        qp_solve(A, V, index, n, tolerance, MAX_ITERATIONS)
        for r in range(3 * n):
            start[r] = V[LAM, r]
        for i in range(n):
            V[B, 3 * i] = b[i]
        status, kkt_error, _ = cone_solve(A, V, index, n, tolerance, MAX_ITERATIONS)
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


@fused_kernel
def _solve(A, V, index, n, directions, tolerance, work, lcp_index):  # type: ignore[no-untyped-def]
    """Impulses of the assembled problem into V[LAM], which holds the warm start; returns (status, kkt_error)."""
    if directions.shape[0] > 0:
        return _polyhedral(A, V, n, directions, tolerance, work, lcp_index)
    return solve_exact(A, V, index, n, tolerance)


@fused_kernel
def find_corners(  # type: ignore[no-untyped-def]
    parent, joint_type, corner_body, corner_pos, radius, P, E, R, z0, reach, height, state, place, tau
):
    """Places and heights of all corners, and the rows of those below `reach` (state 1, others 0); whether any is.

    radius: of corners that are spheres [m]; they touch at their lowest point. height: over z = 0.
    """
    low = False
    for c in range(state.shape[0]):
        b = corner_body[c]
        r0, r1, r2 = turned(E, b, corner_pos[c, 0], corner_pos[c, 1], corner_pos[c, 2])
        r0, r1, r2 = P[b, X] + r0, P[b, X + 1] + r1, P[b, X + 2] + r2
        r0, r1, r2 = r0 - radius * R[2, 0], r1 - radius * R[2, 1], r2 - radius * R[2, 2]
        place[c, 0], place[c, 1], place[c, 2] = r0, r1, r2
        height[c] = z0 + R[2, 0] * r0 + R[2, 1] * r1 + R[2, 2] * r2
        state[c] = 0
        if height[c] < reach:
            low = True
            state[c] = 1
            for k in range(3):
                i = k - 1 if k else 2
                contact_row(parent, joint_type, P, b, r0, r1, r2, R[i, 0], R[i, 1], R[i, 2], c, k, tau)
    return low


@fused_kernel
def recovery_time(h, compliance, relaxation, added_mass):  # type: ignore[no-untyped-def]
    """Time [s] over which a corner that touches is to be back where it belongs, in a step of length h.

    A spring at the step's end damps by k h. That is taken off its damper, as far as it goes, and smoothly: of a damper
    that is weaker, and learned, the motion must still tell. An added mass resists what changes the corner's speed.
    """
    if compliance == 0.0:
        return h + relaxation
    return math.sqrt(h * h + relaxation * relaxation) + added_mass * compliance / h


@fused_kernel
def kept_speed(h, compliance, relaxation, added_mass):  # type: ignore[no-untyped-def]
    """Shares of a touching corner's speed, along the normal and across, that its added mass keeps through a step.

    With m' dv/dt + d v + k z = -f along the normal, and m' dv/dt + d v = -f across, which no spring holds.
    """
    inert = added_mass * compliance
    if inert == 0.0:
        return 0.0, 0.0
    return inert / (h * recovery_time(h, compliance, relaxation, added_mass)), inert / (inert + h * relaxation)


@fused_kernel
def _assemble(  # type: ignore[no-untyped-def]
    state, height, tau, mu, restitution, compliance, relaxation, cohesion, lawful, law, warm, cold, bounces,
    L, u, u_before, xi, xi_before, h, chosen, G, A, V, over_m,
):  # fmt: skip
    """The candidates' contact problem (G, A, V[B], V[MU], warm start V[LAM]); returns their number, 0 if all open."""
    nx, added = xi.shape[0], law.added_mass if lawful else 0.0
    keeps, keeps_across = kept_speed(h, compliance, relaxation, added)
    n, closed = np.int64(0), True  # a literal zero would have numba compile what it is handed to twice
    for c in range(state.shape[0]):
        if state[c] != 2:
            continue
        r = 3 * n
        for k in range(3):
            free = u[k]
            for x in range(nx):
                t = tau[c, k, x]
                free += t * xi[x]
                for j in range(x):
                    t -= L[x, j] * G[j, r + k]
                G[x, r + k] = t * L[x, x]
            V[B, r + k] = free
            V[LAM, r + k] = 0.0 if cold else warm[c, k]
        free, lasts = V[B, r], 0.0
        target = height[c] / h + free
        if restitution > 0.0 and target < 0.0:
            before = u_before[0]
            for x in range(nx):
                before += tau[c, 0, x] * xi_before[x]
            if before < -BOUNCE_SPEED and (bounces or before > -IMPACT_SPEED):
                target = min(target, free + restitution * before)
        elif target < 0.0 or height[c] < 0.0:
            target = height[c] / recovery_time(h, compliance, relaxation, added) + free
            if keeps > 0.0:
                kept, lasts = u_before[0], keeps_across
                for x in range(nx):
                    kept += tau[c, 0, x] * xi_before[x]
                target -= keeps * kept
        V[B, r] = target
        grip = mu[c]
        if lawful:
            slip1, slip2 = u_before[1], u_before[2]
            for x in range(nx):
                slip1 += tau[c, 1, x] * xi_before[x]
                slip2 += tau[c, 2, x] * xi_before[x]
            grip = friction_of(law, grip, slip1, slip2, V[B, r + 1], V[B, r + 2])
            V[B, r + 1] -= lasts * slip1
            V[B, r + 2] -= lasts * slip2
        if cohesion > 0.0 and not cold and warm[c, 0] > 0.0:
            grip = min(2.0 * grip, grip + cohesion * h / warm[c, 0])
        V[MU, n] = grip
        chosen[n] = c
        closed = closed and target >= 0.0
        n += 1
    if closed:
        return 0
    for i in range(3 * n):
        for j in range(i + 1):
            A[i, j] = G[0, i] * G[0, j] + G[1, i] * G[1, j] + G[2, i] * G[2, j]
        for x in range(3, nx):
            for j in range(i + 1):
                A[i, j] += G[x, i] * G[x, j]
        for j in range(i % 3, i + 1, 3):
            A[i, j] += over_m
        for j in range(i):
            A[j, i] = A[i, j]
    soft = compliance / (h * recovery_time(h, compliance, relaxation, added))
    for i in range(0, 3 * n, 3):
        A[i, i] += soft
        A[i + 1, i + 1] += TANGENTIAL * soft
        A[i + 2, i + 2] += TANGENTIAL * soft
    return n


@fused_kernel
def resolve_contact(  # type: ignore[no-untyped-def]
    mu, restitution, compliance, relaxation, cohesion, lawful, law,
    L, over_m, u, u_before, xi, xi_before, h, tolerance, cold, strike, bounces,
    height, state, chosen, tau, G, A, warm, y, V, index, directions, lcp_work, lcp_index,
):  # fmt: skip
    """Contact impulses of one step: u (3: z, x, y) and xi (n_x,) become those after it. After `find_corners`.

    height (n_c,): over the ground as it is below each corner. strike: the step has no length, nor a part in `warm`.
    bounces: restitution acts at any speed of approach, not only below `IMPACT_SPEED`.

    Returns (candidates, 0 if none is hit; touched, status, kkt_error); the candidates' impulses are V[LAM].
    """
    nx, afresh = xi.shape[0], cold or strike
    for c in range(state.shape[0]):
        if state[c] > 0:
            vn = u[0]
            for x in range(nx):
                vn += tau[c, 0, x] * xi[x]
            state[c] = 2 if height[c] / h + vn < CLOSING_SPEED else 1
    for _ in range(4):
        n = _assemble(
            state, height, tau, mu, restitution, compliance, relaxation, cohesion, lawful, law, warm, afresh, bounces,
            L, u, u_before, xi, xi_before, h, chosen, G, A, V, over_m,
        )  # fmt: skip
        if n == 0:
            return 0, False, 0, 0.0
        lifts = False
        if lawful and law.lifting > 0.0:
            for c in range(state.shape[0]):
                lifts = lifts or (state[c] == 2 and height[c] < law.lifting)
        if lifts:
            status, kkt_error, _ = qp_solve(A, V, index, n, tolerance, MAX_ITERATIONS)
        else:
            status, kkt_error = _solve(A, V, index, n, directions, tolerance, lcp_work, lcp_index)
        touched, f0, f1, f2 = False, 0.0, 0.0, 0.0
        for r in range(0, 3 * n, 3):
            f0, f1, f2 = f0 + V[LAM, r], f1 + V[LAM, r + 1], f2 + V[LAM, r + 2]
            touched = touched or V[LAM, r] != 0.0 or V[LAM, r + 1] != 0.0 or V[LAM, r + 2] != 0.0
        for x in range(nx):
            s = 0.0
            for r in range(3 * n):
                s += G[x, r] * V[LAM, r]
            y[x] = s
        back(L, y, nx)
        hit = False
        for c in range(state.shape[0]):
            if state[c] == 1:
                vn = u[0] + over_m * f0
                for x in range(nx):
                    vn += tau[c, 0, x] * (xi[x] + y[x])
                if height[c] / h + vn < 0.0:
                    state[c] = 2
                    hit = True
        if not hit:
            break
    u[0], u[1], u[2] = u[0] + over_m * f0, u[1] + over_m * f1, u[2] + over_m * f2
    for x in range(nx):
        xi[x] += y[x]
    return n, touched, status, kkt_error
