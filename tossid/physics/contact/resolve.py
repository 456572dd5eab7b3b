"""Contact resolved: the candidates' problem solved, in parts where an impact is, and its impulses applied."""

from __future__ import annotations

from tossid.kernels import inlined_kernel
from tossid.physics.contact.problem import CANDIDATE, FAR, LOW, assemble, velocity
from tossid.physics.moving import add_impulse, inverse_mass, n_rates
from tossid.physics.solvers.cones import solve_cones
from tossid.physics.solvers.registry import solve_contact
from tossid.physics.solvers.workspace import LAM

MAX_ITERATIONS = 40
"""Of the convex programme that relaxed friction is solved by."""
CLOSING_SPEED = 1.0
"""A corner joins the contact problem at once if it would touch within this speed [m/s]; others when they are hit.

Not a setting: those left out are looked at again once impulses are known, so that it decides how soon a problem is
solved, and not what the motion is.
"""
ROUNDS = 4
"""A contact problem is solved at most so many times, each with the corners that the last one left to be hit."""


@inlined_kernel
def is_relaxed(law, corners, n):  # type: ignore[no-untyped-def]
    """Whether a candidate is so near the ground that the problem is the convex relaxation of Coulomb's law."""
    relaxed = False
    for i in range(n):
        relaxed = relaxed or corners.gap[corners.chosen[i]] < law.beyond.lifting
    return relaxed


@inlined_kernel
def apply_impulses(model, work, s, corners, n, h):  # type: ignore[no-untyped-def]
    """u + sum lam / m and xi + W sum G lam, and corners that this would drive into the ground become candidates.

    Returns:
        (whether there are such corners, whether any impulse is not zero, the sums over m along z, x and y).
    """
    nx, V, G, g, xi, tau = n_rates(model), corners.V, corners.G, corners.g, corners.xi, corners.tau
    touched, f0, f1, f2 = False, 0.0, 0.0, 0.0
    for r in range(0, 3 * n, 3):
        f0, f1, f2 = f0 + V[LAM, r], f1 + V[LAM, r + 1], f2 + V[LAM, r + 2]
        touched = touched or V[LAM, r] != 0.0 or V[LAM, r + 1] != 0.0 or V[LAM, r + 2] != 0.0
    for x in range(nx):
        total = 0.0
        for r in range(0, 3 * n, 3):
            total += G[x, r] * V[LAM, r] + G[x, r + 1] * V[LAM, r + 1] + G[x, r + 2] * V[LAM, r + 2]
        g[x] = total
    add_impulse(model, work, g, s.xi, xi)
    over_m = inverse_mass(model, work)
    f0, f1, f2 = over_m * f0, over_m * f1, over_m * f2
    hit = False
    for c in range(corners.state.shape[0]):
        if corners.state[c] == LOW:
            vn = s.u[0] + f0
            for x in range(nx):
                vn += tau[c, 0, x] * xi[x]
            if corners.gap[c] / h + vn < 0.0:
                corners.state[c] = CANDIDATE
                hit = True
    return hit, touched, f0, f1, f2


@inlined_kernel
def find_candidates(model, law, s, corners, h, done):  # type: ignore[no-untyped-def]
    """Corners that touch or come near the ground in a step become candidates, the others within reach LOW.

    Those that an impact in parts bounces stay candidates while they leave.
    """
    nx = n_rates(model)
    for c in range(corners.state.shape[0]):
        if corners.gap[c] >= law.beyond.margin:
            corners.state[c] = FAR
        if corners.state[c] != FAR:
            near = corners.gap[c] / h + velocity(corners.tau, c, 0, s.u, s.xi, nx) < CLOSING_SPEED
            if done > 0.0 and corners.gap[c] <= 0.0:
                near = near or velocity(corners.tau, c, 0, s.u_start, s.xi_start, nx) < 0.0
            corners.state[c] = CANDIDATE if near else LOW


@inlined_kernel
def solve_part(model, law, solver, work, s, corners, step, bounces, tolerance, done):  # type: ignore[no-untyped-def]
    """The contact problem of a step, or of the part of an impact that ends when `done` of it is; its impulses applied.

    Returns:
        (candidates, 0 if none is hit; touched; status; KKT error).
    """
    find_candidates(model, law, s, corners, step.h, done)
    n, touched, status, kkt_error = 0, False, 0, 0.0
    f0, f1, f2 = 0.0, 0.0, 0.0
    for _ in range(ROUNDS):
        n = assemble(model, law, work, s, corners, step, bounces, done)
        if n == 0:
            break
        if law.beyond.lifting > 0.0 and is_relaxed(law, corners, n):
            status, kkt_error = solve_cones(
                corners.A, corners.V, corners.solver_index, n, tolerance, MAX_ITERATIONS, False
            )
        else:
            status, kkt_error = solve_contact(solver, corners.A, corners.V, corners.solver_index, n, tolerance)
        hit, touched, f0, f1, f2 = apply_impulses(model, work, s, corners, n, step.h)
        if not hit:
            break
    if n > 0:
        s.u[0], s.u[1], s.u[2] = s.u[0] + f0, s.u[1] + f1, s.u[2] + f2
        for x in range(n_rates(model)):
            s.xi[x] = corners.xi[x]
    return n, touched, status, kkt_error


@inlined_kernel
def resolve_contact(model, law, solver, work, s, corners, step, bounces, tolerance):  # type: ignore[no-untyped-def]
    """Contact in one step: s.u and s.xi become those after it. After `find_corners` and the gaps.

    An impact may be resolved in parts (`Law.impulse_parts`). Its corners come to rest, and bounce, in equal shares of
    their speeds, and friction in each part is against the mean of the slips at its beginning and end (eq. 8).

    bounces: restitution acts at any approach, not only below `IMPACT_SPEED`.

    Returns:
        (candidates, 0 if none is hit; touched; status; KKT error); the candidates' impulses are V[LAM].
    """
    n, touched, status, kkt_error = 0, False, 0, 0.0
    parts = law.beyond.impulse_parts if step.strike else 1.0
    for c in range(corners.state.shape[0]):
        corners.struck[c] = 0.0
    part = 1.0
    while part <= parts:
        done = part / parts if parts > 1.0 else 0.0
        n, touched, now, error = solve_part(model, law, solver, work, s, corners, step, bounces, tolerance, done)
        status, kkt_error = max(status, now), max(kkt_error, error)
        for i in range(n):
            corners.struck[corners.chosen[i]] += corners.V[LAM, 3 * i]
        part += 1.0
    if parts > 1.0:
        n = sum_of_parts(corners)
        touched = n > 0
    return n, touched, status, kkt_error


@inlined_kernel
def sum_of_parts(corners):  # type: ignore[no-untyped-def]
    """The impulses of an impact's parts become those of candidates; how many carried load."""
    n, V = 0, corners.V
    for c in range(corners.state.shape[0]):
        if corners.struck[c] > 0.0:
            corners.chosen[n] = c
            V[LAM, 3 * n], V[LAM, 3 * n + 1], V[LAM, 3 * n + 2] = corners.struck[c], 0.0, 0.0
            n += 1
    return n
