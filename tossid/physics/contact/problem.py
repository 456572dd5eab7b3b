"""The contact problem of one step: which corners, their rows, the solution, its effect.

One code for a single body and a tree (`moving` says what differs). With u the velocity of the common centre of mass
and xi the rates, every corner has three rows (directions: the world's z, the normal, then x and y)

    velocity_k = u_k + tau_k . xi,      A_ij = [same direction] / m + G_i . G_j,      G = W^T tau,  S^-1 = W W^T

and the problem is w = A lam + b. Numbers of equations are those of docs/method/scheme.md; the law is in `law`.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tossid.kernels import fused_kernel, inlined_kernel
from tossid.physics.contact.law import (
    RECOVERY_SPEED,
    UNKNOWN,
    above_ground,
    friction_coefficient,
    is_pressed,
    normal_target,
    recovery_time,
    with_cohesion,
)
from tossid.physics.moving import contact_row, corner_place, inverse_mass, n_rates, turning, whiten
from tossid.physics.solvers.workspace import LAM, MU, B, work_arrays

Array = NDArray[np.float64]

TANGENTIAL = 1e-3
"""Slack of a compliant corner's tangential rows over that of its normal row: sigma of Castro et al., their value."""
FAR, LOW, CANDIDATE = 0, 1, 2
"""State of a corner: out of reach; within reach; in the contact problem."""
SLIDES_ON = 4.0
"""A corner begins to count as one that slides through a step where its slip is so many times what friction under the
last step's load would change alone, and does so at twice as much.

Not a setting: friction of a corner that may stop is against its slip at the step's end, which is of first order.
"""


class Corners(NamedTuple):
    """Corners of a step and the contact problem of the candidates among them.

    Attributes:
        height: (n_c,) over z = 0 [m].
        gap: (n_c,) phi of the contact problem [m]: the height over the ground as it is below the corner.
        sunk: (n_c,) how far the ground gives way below each: 0, or less where the toss began in it [m].
        state: (n_c,) FAR, LOW or CANDIDATE.
        chosen: (n_c,) corner of each candidate.
        place: (n_c, 3) from the base's origin, its axes [m].
        tau: (n_c, 3, n_x) rows of every corner that is not far: normal, t1, t2.
        G: (n_x, 3 n_c) columns W^T tau of the candidates.
        A: (3 n_c, 3 n_c) Delassus matrix.
        warm: (n_c, 3) impulses of the last step [N s], zero if it had none.
        span: (1,) length of the step that `warm` is of [s].
        carried: (n_c,) normal impulses over the parts of a step [N s].
        struck: (n_c,) normal impulses over the parts of an impact [N s].
        load: (n_c,) normal impulses on which resistance to spin and cohesion hang, of the last step or of the last
            solution of this one [N s].
        g: (n_x,) sum of G lam; scratch.
        xi: (n_x,) rates after the impulses.
        V: problem, answer and scratch of the solver, see `solvers.workspace`.
        solver_index: integers of the same.
    """

    height: Array
    gap: Array
    sunk: Array
    state: NDArray[np.int64]
    chosen: NDArray[np.int64]
    place: Array
    tau: Array
    G: Array
    A: Array
    warm: Array
    span: Array
    carried: Array
    struck: Array
    load: Array
    g: Array
    xi: Array
    V: Array
    solver_index: NDArray[np.int64]


@fused_kernel
def make_corners(nc, nx):  # type: ignore[no-untyped-def]
    """Scratch for n_c corners and n_x rates."""
    V, index = work_arrays(nc)
    return Corners(
        np.zeros(nc), np.zeros(nc), np.zeros(nc),
        np.zeros(nc, np.int64), np.zeros(nc, np.int64), np.zeros((nc, 3)),
        np.zeros((nc, 3, nx)), np.zeros((nx, 3 * nc)), np.zeros((3 * nc, 3 * nc)), np.zeros((nc, 3)), np.zeros(1),
        np.zeros(nc), np.zeros(nc), np.zeros(nc), np.zeros(nx), np.zeros(nx), V, index,
    )  # fmt: skip


@inlined_kernel
def velocity(tau, c, k, u, xi, nx):  # type: ignore[no-untyped-def]
    """u_k + tau_k . xi: velocity of corner c along its direction k [m/s]."""
    v = u[k]
    for x in range(nx):
        v += tau[c, k, x] * xi[x]
    return v


@inlined_kernel
def find_corners(model, work, s, corners, radius, h):  # type: ignore[no-untyped-def]
    """Places and heights of all corners, and the normal rows of those within reach; whether any is.

    radius: of corners that are spheres [m]; they touch at their lowest point.
    """
    nx, low = n_rates(model), False
    speed = abs(s.v[2] + h * model.gravity[2])
    for x in range(nx):
        speed += 0.2 * abs(s.xi_start[x] + h * s.rate[x])
    reach = 0.02 + 3.0 * h * speed  # farther than a corner moves in a step, contact included
    up0, up1, up2, z0 = s.R[2, 0], s.R[2, 1], s.R[2, 2], s.q[2]
    for c in range(corners.state.shape[0]):
        r0, r1, r2 = corner_place(model, work, s, c)
        r0, r1, r2 = r0 - radius * up0, r1 - radius * up1, r2 - radius * up2
        z = z0 + up0 * r0 + up1 * r1 + up2 * r2
        corners.height[c], corners.state[c] = z, FAR
        if z < reach:
            low = True
            corners.state[c] = LOW
            corners.place[c, 0], corners.place[c, 1], corners.place[c, 2] = r0, r1, r2
            contact_row(model, work, s, corners, c, 0)
    return low


@inlined_kernel
def find_rows(model, work, s, corners, radius):  # type: ignore[no-untyped-def]
    """Places and rows of the corners within reach, for s.R and the kinematics as they are now."""
    up0, up1, up2 = s.R[2, 0], s.R[2, 1], s.R[2, 2]
    for c in range(corners.state.shape[0]):
        if corners.state[c] != FAR:
            r0, r1, r2 = corner_place(model, work, s, c)
            corners.place[c, 0] = r0 - radius * up0
            corners.place[c, 1] = r1 - radius * up1
            corners.place[c, 2] = r2 - radius * up2
            for k in range(3):
                contact_row(model, work, s, corners, c, k)


@inlined_kernel
def begin_toss(corners, span):  # type: ignore[no-untyped-def]
    """Nothing is known of the ground below, and no step, of length `span` [s], has had impulses."""
    corners.span[0] = span
    for c in range(corners.state.shape[0]):
        corners.sunk[c] = UNKNOWN
    keep_warm(corners, 0)


@inlined_kernel
def keep_warm(corners, n):  # type: ignore[no-untyped-def]
    """The impulses of this step's n candidates become the next one's warm start."""
    for c in range(corners.warm.shape[0]):
        corners.warm[c, 0], corners.warm[c, 1], corners.warm[c, 2] = 0.0, 0.0, 0.0
    for i in range(n):
        for k in range(3):
            corners.warm[corners.chosen[i], k] = corners.V[LAM, 3 * i + k]


@inlined_kernel
def gives_way(corners):  # type: ignore[no-untyped-def]
    """Whether the ground is, or may be, below z = 0 under a corner."""
    found = False
    for c in range(corners.sunk.shape[0]):
        found = found or corners.sunk[c] != 0.0
    return found


@inlined_kernel
def find_gaps_of_strike(law, corners, h):  # type: ignore[no-untyped-def]
    """The gaps of a strike, whose length h is next to none: what touches is on the ground."""
    for c in range(corners.state.shape[0]):
        z = above_ground(law, corners.height[c], c, corners.sunk, h)
        corners.gap[c] = 0.0 if z < law.touching_height else z


@inlined_kernel
def find_gaps(model, law, work, s, corners, at_impacts, midpoint, h, step):  # type: ignore[no-untyped-def]
    """The gaps of a step of length h. With s.u and s.xi as they are in free motion.

    Where steps end at impacts (`at_impacts`), a gap has what turning does in the step, h² dJ_n/dt v / 2, which no row
    has (eq. 7). Without it, a corner that lands by turning is held back before it does. A corner that touches has no
    normal velocity at the step's end then, if rows are those of its middle (`midpoint`). One that does not moves by
    the mean of both velocities.

    step: length of a whole one [s].
    """
    nx = n_rates(model)
    for c in range(corners.state.shape[0]):
        z = above_ground(law, corners.height[c], c, corners.sunk, h)
        flies = not z < law.touching_height
        if law.rigid and z < 0.0:
            z *= h / max(h, step)  # comes out within a whole step
        elif at_impacts and not flies:
            z = min(z, RECOVERY_SPEED * h)  # is on the ground, and recovers there
        if at_impacts and corners.state[c] != FAR and law.beyond.lifting == 0.0:
            before = velocity(corners.tau, c, 0, s.u_start, s.xi_start, nx)
            if midpoint and flies:
                z += z + h * before  # by half of z + h J_n v'
            else:
                z += 0.5 * h * h * turning(model, work, s, corners, c, 0)
                z += 0.5 * h * (before - velocity(corners.tau, c, 0, s.u, s.xi, nx)) if flies else 0.0
        corners.gap[c] = z


@inlined_kernel
def slides_on(slip1, slip2, changes):  # type: ignore[no-untyped-def]
    """How far a corner counts as one that slides through a step, 0 to 1: its slip over what friction would change."""
    return min(1.0, max(0.0, math.sqrt(slip1 * slip1 + slip2 * slip2) / changes - 1.0))


@inlined_kernel
def add_slip_of_middle(model, work, s, corners, c, n, h, mu):  # type: ignore[no-untyped-def]
    """Add to V[B]'s tangential rows of candidate n, corner c, what those of the step's middle lack (eq. 10).

    Friction of what slides on is against the mean of the slips at the step's start and end, (J_t v + J_t v') / 2. What
    may stop has no slip at the end, J_t v' + h/2 dJ_t/dt v.
    """
    r, tau, V, G, nx = 3 * n, corners.tau, corners.V, corners.G, n_rates(model)
    slip1 = velocity(tau, c, 1, s.u_start, s.xi_start, nx)
    slip2 = velocity(tau, c, 2, s.u_start, s.xi_start, nx)
    mean = 0.0
    if mu * corners.warm[c, 0] > 0.0:
        across = inverse_mass(model, work)
        for x in range(nx):
            across += 0.5 * (G[x, r + 1] * G[x, r + 1] + G[x, r + 2] * G[x, r + 2])
        mean = slides_on(slip1, slip2, SLIDES_ON * mu * corners.warm[c, 0] * across)
    V[B, r + 1] += mean * slip1 + (1.0 - mean) * 0.5 * h * turning(model, work, s, corners, c, 1)
    V[B, r + 2] += mean * slip2 + (1.0 - mean) * 0.5 * h * turning(model, work, s, corners, c, 2)


@inlined_kernel
def add_slip_of_part(model, work, corners, n, target, mu):  # type: ignore[no-untyped-def]
    """Add to V[B]'s tangential rows of candidate n what makes friction oppose the mean slip of an impact's part.

    As in `add_slip_of_middle`, of what slides on through the part alone, by the load that its target asks for.
    """
    r, V, G = 3 * n, corners.V, corners.G
    normal = across = inverse_mass(model, work)
    for x in range(n_rates(model)):
        normal += G[x, r] * G[x, r]
        across += 0.5 * (G[x, r + 1] * G[x, r + 1] + G[x, r + 2] * G[x, r + 2])
    changes = SLIDES_ON * mu * across * max(0.0, -target) / normal
    if changes > 0.0:
        slip1, slip2 = V[B, r + 1], V[B, r + 2]
        mean = slides_on(slip1, slip2, changes)
        V[B, r + 1] += mean * slip1
        V[B, r + 2] += mean * slip2


@inlined_kernel
def set_row(model, law, work, s, corners, c, n, step, bounces, done):  # type: ignore[no-untyped-def]
    """V[B] and V[MU] of candidate n, corner c, by the law of contact; whether it is pressed.

    V[B] has the corner's free velocity: b_t = J_t v_free, and b_n is `normal_target`. The rest is as in `assemble`.
    """
    r, tau, V, nx, phi, mu = 3 * n, corners.tau, corners.V, n_rates(model), corners.gap[c], law.mu[c]
    before = velocity(tau, c, 0, s.u_start, s.xi_start, nx)
    target, kept = normal_target(law, phi, V[B, r], before, step.h, bounces, done)
    V[B, r] = target
    if law.varied:
        slip1, slip2 = V[B, r + 1], V[B, r + 2]
        if done == 0.0:
            slip1 = velocity(tau, c, 1, s.u_start, s.xi_start, nx)
            slip2 = velocity(tau, c, 2, s.u_start, s.xi_start, nx)
        mu = friction_coefficient(law.beyond, mu, slip1, slip2, V[B, r + 1], V[B, r + 2])
        V[B, r + 1] -= kept * slip1
        V[B, r + 2] -= kept * slip2
    mu = with_cohesion(law, mu, corners.load[c], step.h)
    V[MU, n] = mu
    if step.midpoint:
        add_slip_of_middle(model, work, s, corners, c, n, step.h, mu)
    if done > 0.0 and phi <= 0.0:
        add_slip_of_part(model, work, corners, n, target, mu)
    return is_pressed(law, phi, target, mu, V[B, r + 1], V[B, r + 2])


@inlined_kernel
def delassus(corners, n, nx, over_m, slack):  # type: ignore[no-untyped-def]
    """A_ij = [same direction] / m + G_i . G_j (3 n, 3 n), with the compliant corners' slack on its diagonal."""
    A, G = corners.A, corners.G
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
    for i in range(0, 3 * n, 3):
        A[i, i] += slack
        A[i + 1, i + 1] += TANGENTIAL * slack
        A[i + 2, i + 2] += TANGENTIAL * slack


@inlined_kernel
def assemble(model, law, work, s, corners, step, bounces, done):  # type: ignore[no-untyped-def]
    """The candidates' contact problem (G, A, V[B], V[MU], warm start V[LAM]); their number, 0 if all stay open.

    step: a `Step`. bounces: restitution acts at any approach. done: share of an impact that a part of it ends with.
    """
    nx, V, tau = n_rates(model), corners.V, corners.tau
    n, pressed = 0, False
    for c in range(corners.state.shape[0]):
        if corners.state[c] != CANDIDATE:
            continue
        r = 3 * n
        for k in range(3):
            whiten(model, work, corners, c, k, r + k)
            free = 0.0
            for x in range(nx):
                free += tau[c, k, x] * s.xi[x]
            V[B, r + k] = free + s.u[k]
            V[LAM, r + k] = 0.0 if step.strike else corners.warm[c, k]
        pressed = set_row(model, law, work, s, corners, c, n, step, bounces, done) or pressed
        corners.chosen[n] = c
        n += 1
    if not pressed:
        return 0
    slack = law.compliance / (step.h * recovery_time(law, step.h))
    delassus(corners, n, nx, inverse_mass(model, work), slack)
    return n
