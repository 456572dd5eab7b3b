"""Time stepping with contact: Stewart and Trinkle's scheme over batches of tosses.

One step of length h from (q, v), with a the acceleration without contact:

    v_free = v + h a(q, v)
    find the corners' impulses lam with  0 <= lam_n  _|_  phi(q) + h J_n v' >= 0  and Coulomb friction
    v' = v_free + M^-1 J^T lam
    q' = q moved along v' if anything touches, else along (v + v') / 2 (exact for constant a)

Stewart and Trinkle, "An implicit time-stepping scheme for rigid body dynamics
with inelastic collisions and Coulomb friction", IJNME 1996. Restitution, where
there is any, is Newton's: an approaching corner must leave with J_n v' >= -e J_n v.

A compliant corner is a spring and a damper at the step's end, phi' = phi + h J_n v',

    lam_n / h = max(0, -k phi' - d J_n v'),     k = 1 / compliance,     d = k relaxation

which is the complementarity of a rigid one with another gap and a slack:

    0 <= lam_n  _|_  phi / (h + relaxation) + J_n v' + compliance / (h (h + relaxation)) lam_n >= 0

as in Castro, Permenter and Han, "An unconstrained convex formulation of compliant
contact", T-RO 2022 (whose convex friction is not used here). The damper does not
act at a distance: a corner above the ground that would not reach it in free motion,
and is pushed there by others, has phi / h for its gap. Its tangential rows have
a thousandth of the slack (their sigma): several compliant corners that stick would
else leave only slips of 1e-6 m/s to balance their loads, which no solver finds soon.
A sticking corner creeps by that slack times lam_t, 1e-5 m/s for a newton at 33 kN/m.

Where a toss begins with a corner in rigid ground, the ground is as deep below that corner and rises at 2 cm/s
(`above_ground`): recorded states are noisy, and phi / h of a depth that is noise would be a kick.

An impact that falls into a step is felt in two parts: at its end, so much of the impulse as brings the corner to the
ground by then, and the rest a step later. Two parts are not the same impulse where friction turns or others are hit,
and how large each is hangs on where in the step the impact was: motions sway with the grid of steps, by 0.1 to 0.4 mm
after a few frames, however short the steps are. With `impact_parts`, a step of rigid contact ends where a corner
touches, and the impulse is felt there at once (as in event-driven schemes; Studer, "Numerics of Unilateral Contacts and
Friction", 2009). Contact that gives way has no such moment; there steps with an impact are cut in so many, which costs
impacts' share, and the error in their time falls in proportion.

Cohesion c lets friction grow less than in proportion to load (Mohr and Coulomb),
|lam_t| <= mu lam_n + c h, with the load of the step before in place of this one's:
the friction coefficient of the step is min(2 mu, mu + c h / lam_n of the step before),
and mu where there was no load.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tossid.errors import InputError
from tossid.physics.articulated import (
    FORCE,
    MASS,
    WIDTH,
    common_velocity,
    factor,
    inwards,
    jit,
    make_articulated,
    outwards,
    tree_features,
)
from tossid.physics.body import network, simulate_body
from tossid.physics.contact import UNKNOWN, make_scratch, resolve_contact
from tossid.physics.forces import forces_of, law_of
from tossid.physics.single import make_body
from tossid.physics.solvers import cone_work
from tossid.physics.solvers.batches import over_threads
from tossid.physics.system import System
from tossid.physics.tree import integrate_configuration, quat_to_mat

Array = NDArray[np.float64]

TOLERANCE = 1e-7
"""Residual [m/s] below which a step's contact problem counts as solved."""


class Simulation(NamedTuple):
    """Simulated tosses.

    q (B, T + 1, nq), v (B, T + 1, nv); frames past a toss's own number of steps
    hold its last state. lam_n (B, T, n_c): normal impulse of each corner over the
    frame [N s]. unsolved (B,): steps whose contact problem missed the tolerance.
    residual (B,): the largest residual met [m/s]. finite (B,): False where a state
    became NaN or infinite, or M lost its definiteness: the toss stays at its last finite state.
    """

    q: Array
    v: Array
    lam_n: Array
    unsolved: NDArray[np.int64]
    residual: Array
    finite: NDArray[np.bool_]


@jit
def _simulate(  # type: ignore[no-untyped-def]
    parent, joint_type, turn, place, axis, anchor, mass, com, inertia, corner_body, corner_pos, mu, restitution,
    compliance, relaxation, cohesion, gravity, linear, W0, b0, W1, b1, W2,
    q0, v0, n_steps, dt, substeps, tolerance, first, last, qs, vs, lam_n, unsolved, worst, finite,
    height, sunk, state, chosen, tau, G, A, warm, y, V, index, directions, lcp_work, lcp_index,
):  # fmt: skip
    """Simulate tosses first..last-1 of any tree; arguments and results as in `simulate`."""
    nq, nv, nb = q0.shape[1], v0.shape[1], parent.shape[0]
    nx = nv - 3
    q, v, vf, moved, mean = np.empty(nq), np.empty(nv), np.empty(nv), np.empty(nq), np.empty(nv)
    P, E, L, R = np.zeros((nb, WIDTH)), np.zeros((nb, 3, 3)), np.zeros((nx, nx)), np.empty((3, 3))
    xi, rate, before, u = np.empty(nx), np.empty(nx), np.empty(nx), np.empty(3)
    f, h0, h1 = np.empty(6 + 3 * nb), np.empty(b0.shape[0]), np.empty(b0.shape[0])
    extra, learned = np.zeros(nv), linear.shape[0] > 0
    h = dt / substeps
    for toss in range(first, last):
        for i in range(nq):
            q[i] = qs[toss, 0, i] = q0[toss, i]
        for i in range(nv):
            v[i] = vs[toss, 0, i] = v0[toss, i]
        cold = True
        sunk[:] = UNKNOWN
        reached = 0
        for step in range(n_steps[toss]):
            for _ in range(substeps):
                quat_to_mat(q[3], q[4], q[5], q[6], R)
                outwards(parent, joint_type, turn, place, axis, anchor, q, v, P, E)
                inwards(parent, mass, com, inertia, P, E)
                good = factor(parent, joint_type, P, L, rate)
                a0, a1, a2 = common_velocity(P, rate, 0)
                over_m = 1.0 / P[0, MASS]
                a0, a1, a2 = a0 + over_m * P[0, FORCE], a1 + over_m * P[0, FORCE + 1], a2 + over_m * P[0, FORCE + 2]
                if learned:
                    tree_features(R, q, v, f)
                    network(linear, W0, b0, W1, b1, W2, f, h0, h1, extra)
                    a0, a1, a2 = a0 - extra[0], a1 - extra[1], a2 - extra[2]
                    for x in range(nx):
                        rate[x] += extra[3 + x]
                for i in range(3):
                    vf[i] = v[i] + h * (gravity[i] - (R[i, 0] * a0 + R[i, 1] * a1 + R[i, 2] * a2))
                speed = abs(vf[2])
                for x in range(nx):
                    before[x] = v[3 + x]
                    xi[x] = vf[3 + x] = v[3 + x] + h * rate[x]
                    speed += 0.2 * abs(xi[x])
                reach = 0.02 + 3.0 * h * speed  # farther than a corner moves in a step, contact included
                c0, c1, c2 = common_velocity(P, v, 3)
                u_before = v[2] + R[2, 0] * c0 + R[2, 1] * c1 + R[2, 2] * c2
                c0, c1, c2 = common_velocity(P, xi, 0)
                for k in range(3):
                    i = k - 1 if k else 2
                    u[k] = vf[i] + R[i, 0] * c0 + R[i, 1] * c1 + R[i, 2] * c2
                n, touched, status, residual = resolve_contact(
                    parent, joint_type, corner_body, corner_pos, mu, restitution, compliance, relaxation, cohesion,
                    P, E, R, L, q[2], reach, u, u_before, xi, before, h, tolerance, cold,
                    height, sunk, state, chosen, tau, G, A, warm, y, V, index, directions, lcp_work, lcp_index,
                )  # fmt: skip
                cold = n == 0
                if n > 0:
                    c0, c1, c2 = common_velocity(P, xi, 0)
                    for k in range(3):
                        i = k - 1 if k else 2
                        vf[i] = u[k] - (R[i, 0] * c0 + R[i, 1] * c1 + R[i, 2] * c2)
                    for x in range(nx):
                        vf[3 + x] = xi[x]
                if touched:
                    for c in range(warm.shape[0]):
                        lam_n[toss, step, c] += warm[c, 0]
                    integrate_configuration(q, vf, h, moved)
                else:
                    for i in range(nv):
                        mean[i] = 0.5 * (v[i] + vf[i])
                    integrate_configuration(q, mean, h, moved)
                total = 0.0
                for i in range(nq):
                    total += abs(moved[i])
                for i in range(nv):
                    total += abs(vf[i])
                if not (good and total < 1e9):
                    finite[toss] = False
                    break
                if status != 0:
                    unsolved[toss] += 1
                worst[toss] = max(worst[toss], residual)
                q[:] = moved
                v[:] = vf
            if not finite[toss]:
                break
            reached = step + 1
            for i in range(nq):
                qs[toss, reached, i] = q[i]
            for i in range(nv):
                vs[toss, reached, i] = v[i]
        for rest in range(reached + 1, qs.shape[1]):
            qs[toss, rest] = qs[toss, reached]
            vs[toss, rest] = vs[toss, reached]


def simulate(
    system: System,
    q0: Array,
    v0: Array,
    *,
    n_steps: int | NDArray[np.int64],
    dt: float,
    substeps: int = 1,
    impact_parts: int = 1,
    n_directions: int = 0,
    tolerance: float = TOLERANCE,
    n_threads: int = 1,
) -> Simulation:
    """Simulate a batch of tosses.

    Args:
        system: the simulator's parameters.
        q0: (B, nq), v0: (B, nv) initial states.
        n_steps: frames to simulate, one number or one a toss (B,), at least 1.
        dt: time between frames [s], at least `substeps` steps each.
        impact_parts: more than 1 for impacts where they happen: a step in which a corner crosses the ground at more
            than 0.1 m/s ends there or, where contact gives way, is cut in so many. Of a single body.
        n_directions: 0 for the exact friction cone; k >= 4 (even) for the polyhedral
            cone of k directions, solved as an LCP by Lemke's algorithm.
        tolerance: on the contact problem's residual [m/s].
        n_threads: tosses are split over this many threads.

    Raises:
        InputError: shapes that do not fit, or numbers out of range; forces of the state, or contact beyond a
            constant friction, of an object with joints or with the polyhedral cone: the tree's kernel has neither.
    """
    q0, v0 = np.ascontiguousarray(q0, dtype=float), np.ascontiguousarray(v0, dtype=float)
    count = len(q0)
    if q0.shape != (count, system.nq) or v0.shape != (count, system.nv):
        raise InputError(
            f"initial states of shapes {q0.shape} and {v0.shape}, expected (B, {system.nq}) and (B, {system.nv})"
        )
    steps = np.ascontiguousarray(np.broadcast_to(np.asarray(n_steps, dtype=np.int64), (count,)))
    if (steps < 1).any() or substeps < 1 or impact_parts < 1 or not dt > 0:
        raise InputError("a simulation needs dt > 0, and at least one step a toss, one substep a step and one part")
    if n_directions and (n_directions < 4 or n_directions % 2):
        raise InputError(f"n_directions is {n_directions}, expected 0 (exact cone) or an even number from 4")
    T = int(steps.max())
    out = Simulation(
        q=np.empty((count, T + 1, system.nq)),
        v=np.empty((count, T + 1, system.nv)),
        lam_n=np.zeros((count, T, system.n_corners)),
        unsolved=np.zeros(count, dtype=np.int64),
        residual=np.zeros(count),
        finite=np.ones(count, dtype=bool),
    )

    body = make_body(system) if n_directions == 0 else None
    if body is None:
        _refuse_effects(system, n_directions, impact_parts)

    def part(first: int, last: int) -> None:
        if body is not None:
            simulate_body(
                *body, *system.residual, q0, v0, steps, float(dt), substeps, impact_parts, tolerance, first, last,
                *out, *cone_work(system.n_corners),
            )  # fmt: skip
            return
        _simulate(
            *make_articulated(system), system.corner_body, system.corner_pos, system.mu, float(system.restitution),
            float(system.compliance), float(system.relaxation), float(system.cohesion), system.gravity,
            *system.residual, q0, v0, steps, float(dt), substeps, tolerance, first, last, *out,
            *make_scratch(system, n_directions),
        )  # fmt: skip

    over_threads(part, count, n_threads)
    return out


def _refuse_effects(system: System, n_directions: int, impact_parts: int) -> None:
    """The tree's kernel has no forces of the state, no law of contact but a constant friction, and no cut steps."""
    if impact_parts > 1:
        raise InputError("steps with impacts are cut in parts for a single body with the exact friction cone only")
    if forces_of(system.forces).acts or law_of(system.law).acts:
        what = "the polyhedral friction cone" if n_directions else "objects with joints"
        raise InputError(
            f"{what}: forces of the state (drag, wind, springs, …) and contact beyond a constant friction are not "
            "supported"
        )
