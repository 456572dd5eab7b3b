"""Time stepping of a tree: the scheme of `stepping`, in one kernel over any number of bodies.

Free motion comes from `articulated`, what acts beside gravity from `pulls`, the contact problem from `contact`, and
where a step ends that has an impact in it from `impacts`. A single body has a kernel of its own (`body`), four times
as fast; the two are held together by tests.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tossid.kernels import fused_kernel
from tossid.objects import JointLaw, free_joints
from tossid.physics.articulated import (
    FORCE,
    MASS,
    WIDTH,
    Articulated,
    common_velocity,
    factor,
    inwards,
    make_articulated,
    outwards,
    own,
    tree_features,
)
from tossid.physics.contact import (
    RECOVERY_SPEED,
    STEADY,
    STRIKE,
    TOUCHING,
    UNKNOWN,
    above_ground,
    find_corners,
    resolve_contact,
)
from tossid.physics.forces import Forces, Law, forces_of, law_of
from tossid.physics.impacts import carry_over, first_impact
from tossid.physics.network import network
from tossid.physics.pulls import drive, hold_bodies, pull, resist_spins, rub
from tossid.physics.single import inset
from tossid.physics.solvers.workspace import LAM
from tossid.physics.system import System
from tossid.physics.tree import integrate_configuration, quat_to_mat

Array = NDArray[np.float64]


class Links(NamedTuple):
    """What the kernel reads of a tree; shapes as in `System`. Of rounded corners, corner_pos is their spheres' centres.

    jointed, forced, lawful: whether `joints`, `forces` and `law` act.
    """

    tree: Articulated
    corner_body: NDArray[np.int64]
    corner_pos: Array
    mu: Array
    restitution: float
    compliance: float
    relaxation: float
    cohesion: float
    gravity: Array
    jointed: bool
    joints: JointLaw
    forced: bool
    forces: Forces
    lawful: bool
    law: Law


def make_links(system: System) -> Links:
    """The kernel's view of `system`."""
    forces, law = forces_of(system.forces), law_of(system.law)
    joints = system.joints if len(system.joints.damping) else free_joints(len(system.parent))
    corner_pos = system.corner_pos.copy()
    for body in set(system.corner_body.tolist()):
        mine = system.corner_body == body
        corner_pos[mine] = inset(system.corner_pos[mine], law.rounding)
    return Links(
        tree=make_articulated(system),
        corner_body=system.corner_body,
        corner_pos=corner_pos,
        mu=system.mu,
        restitution=float(system.restitution),
        compliance=float(system.compliance),
        relaxation=float(system.relaxation),
        cohesion=float(system.cohesion),
        gravity=system.gravity,
        jointed=joints.acts,
        joints=joints,
        forced=forces.acts,
        forces=forces,
        lawful=law.acts,
        law=law,
    )


@fused_kernel
def _accelerate(  # type: ignore[no-untyped-def]
    tree, gravity, jointed, joints, forced, forces, total, h, R, q, v, P, E, L, U, torque, slack, rate
):
    """Free motion over a step of length h, before the learned one; after `outwards`.

    rate (n_x,) becomes that of spin and joint rates. Returns whether M is positive, and the origin's acceleration
    against gravity's (base axes).
    """
    own(tree.parent, tree.mass, tree.com, tree.inertia, P, E)
    if forced:
        pull(forces, gravity, tree.parent, tree.joint_type, tree.mass, tree.com, total, h, R, q, v, P, E, U)
    inwards(tree.parent, P)
    if jointed:
        drive(joints, h, q, v, torque, slack)
    good = factor(tree.parent, tree.joint_type, torque, slack, P, L, rate)
    a0, a1, a2 = common_velocity(P, rate, 0)
    over_m = 1.0 / P[0, MASS]
    return good, a0 + over_m * P[0, FORCE], a1 + over_m * P[0, FORCE + 1], a2 + over_m * P[0, FORCE + 2]


@fused_kernel
def simulate_links(  # type: ignore[no-untyped-def]
    tree, corner_body, corner_pos, mu, restitution, compliance, relaxation, cohesion, gravity,
    jointed, joints, forced, forces, lawful, law, linear, W0, b0, W1, b1, W2,
    q0, v0, n_steps, dt, substeps, impact_parts, tolerance, first, last, qs, vs, lam_n, unsolved, worst, finite,
    height, sunk, state, chosen, place, tau, G, A, warm, y, V, index, directions, lcp_work, lcp_index,
):  # fmt: skip
    """Simulate tosses first..last-1 of any tree; arguments and results as in `stepping`, scratch of `contact`."""
    parent, joint_type = tree.parent, tree.joint_type
    nq, nv, nb, nc = q0.shape[1], v0.shape[1], parent.shape[0], mu.shape[0]
    nx = nv - 3
    q, v, vf, moved, mean = np.empty(nq), np.empty(nv), np.empty(nv), np.empty(nq), np.empty(nv)
    P, E, L, R = np.zeros((nb, WIDTH)), np.zeros((nb, 3, 3)), np.zeros((nx, nx)), np.empty((3, 3))
    xi, rate, before, u, u_before = np.empty(nx), np.empty(nx), np.empty(nx), np.empty(3), np.empty(3)
    f, h0, h1 = np.empty(6 + 3 * nb), np.empty(b0.shape[0]), np.empty(b0.shape[0])
    extra, learned = np.zeros(nv), linear.shape[0] > 0
    U, torque, slack, row, raw = np.zeros((nb, 3)), np.zeros(nb), np.zeros(nb), np.zeros((1, 1, nx)), np.zeros(nc)
    carried, taken, total = np.zeros(nc), np.zeros(nb), tree.mass.sum()
    struck, less = np.zeros((nc, 3)), np.zeros(nx)  # less: what contact's resistance takes from xi in a strike
    radius = law.rounding if lawful else 0.0
    rigid = compliance == 0.0 and relaxation == 0.0
    cut = impact_parts > 1
    whole = not (cut and rigid)  # steps do not end at impacts
    rubs = jointed and joints.friction.max() > 0.0
    held = lawful and (law.torsional != 0.0 or law.rolling != 0.0 or law.adhesion != 0.0)
    h = loaded = dt / substeps  # of a step, and of that whose impulses are in `warm`
    for toss in range(first, last):
        for i in range(nq):
            q[i] = qs[toss, 0, i] = q0[toss, i]
        for i in range(nv):
            v[i] = vs[toss, 0, i] = v0[toss, i]
        cold = nc > 0  # not a literal, of which numba would compile a second version
        sunk[:] = UNKNOWN
        reached = 0
        for step in range(n_steps[toss]):
            done, left, rest, strikes, again = 0, 0, dt, np.int64(0), False
            while done < substeps:
                quat_to_mat(q[3], q[4], q[5], q[6], R)
                outwards(parent, joint_type, tree.turn, tree.place, tree.axis, tree.anchor, q, v, P, E)
                begins, strike = cut and left == 0, False
                if begins:
                    h = dt / substeps
                    if rigid:
                        h = rest / max(1.0, np.ceil(rest / h - 1e-6))
                good, a0, a1, a2 = _accelerate(
                    tree, gravity, jointed, joints, forced, forces, total, h, R, q, v, P, E, L, U, torque, slack, rate
                )
                over_m = 1.0 / P[0, MASS]
                if learned:
                    tree_features(R, q, v, f)
                    network(linear, W0, b0, W1, b1, W2, f, h0, h1, extra)
                    a0, a1, a2 = a0 - extra[0], a1 - extra[1], a2 - extra[2]
                    for x in range(nx):
                        rate[x] += extra[3 + x]
                speed = abs(v[2] + h * gravity[2])
                for x in range(nx):
                    before[x] = v[3 + x]
                    speed += 0.2 * abs(before[x] + h * rate[x])
                reach = 0.02 + 3.0 * h * speed  # farther than a corner moves in a step, contact included
                low = find_corners(
                    parent, joint_type, corner_body, corner_pos, radius, P, E, R, q[2], reach, raw, state, place, tau
                )
                c0, c1, c2 = common_velocity(P, v, 3)
                for k in range(3):
                    i = k - 1 if k else 2
                    u_before[k] = v[i] + R[i, 0] * c0 + R[i, 1] * c1 + R[i, 2] * c2
                if begins:
                    left, strike, length = first_impact(
                        P, E, R, corner_body, place, tau, state, raw, sunk, gravity, a0, a1, a2, rate,
                        u_before, before, rigid, strikes, impact_parts, h, dt,
                    )  # fmt: skip
                    if strike:
                        strikes += 1
                        length = STRIKE * dt
                    else:
                        loaded = carry_over(warm, carried, length, loaded, rigid)
                    carried[:] = 0.0
                    if length != h:
                        h = length
                        if forced or jointed:
                            good, a0, a1, a2 = _accelerate(
                                tree, gravity, jointed, joints, forced, forces, total, h, R, q, v, P, E, L, U,
                                torque, slack, rate,
                            )  # fmt: skip
                            a0, a1, a2 = a0 - extra[0], a1 - extra[1], a2 - extra[2]
                            for x in range(nx):
                                rate[x] += extra[3 + x]
                for i in range(3):
                    vf[i] = v[i] + h * (gravity[i] - (R[i, 0] * a0 + R[i, 1] * a1 + R[i, 2] * a2))
                for x in range(nx):
                    xi[x] = vf[3 + x] = before[x] + h * rate[x]
                c0, c1, c2 = common_velocity(P, xi, 0)
                for k in range(3):
                    i = k - 1 if k else 2
                    u[k] = vf[i] + R[i, 0] * c0 + R[i, 1] * c1 + R[i, 2] * c2
                if rubs:
                    rub(joints.friction, h, L, y, taken, xi)
                if held and not strike:
                    hold_bodies(
                        law, parent, joint_type, corner_body, place, raw, over_m, h, R, P, L, warm, cold, row, y, u, xi
                    )
                if again:
                    xi += less
                n, touched, status, kkt_error = 0, False, 0, 0.0
                for c in range(nc):
                    z = above_ground(raw[c], c, sunk, rigid, h)
                    if strike and z < TOUCHING:
                        z = 0.0
                    elif rigid and z < 0.0:
                        z *= h / max(h, dt / substeps)  # comes out within a whole step
                    elif z < TOUCHING and not whole:
                        z = min(z, RECOVERY_SPEED * h)  # is on the ground, and recovers there
                    height[c] = z
                bounces = strike or whole
                if low:
                    n, touched, status, kkt_error = resolve_contact(
                        mu, restitution, compliance, relaxation, cohesion, lawful, law,
                        L, over_m, u, u_before, xi, before, h, tolerance, cold, strike, bounces,
                        height, state, chosen, tau, G, A, warm, y, V, index, directions, lcp_work, lcp_index,
                    )  # fmt: skip
                if n > 0 and not strike:
                    warm[:] = 0.0
                    for i in range(n):
                        for k in range(3):
                            warm[chosen[i], k] = V[LAM, 3 * i + k]
                if n == 0:
                    cold = True
                elif not strike:
                    cold = False
                elif held and not again:  # what resists spin hangs on the impulse, and the impulse on it
                    struck[:] = 0.0
                    for i in range(n):
                        struck[chosen[i], 0] = V[LAM, 3 * i]
                    less[:] = xi
                    resist_spins(law, parent, joint_type, corner_body, R, P, L, struck, row, y, xi)
                    less[:] = xi - less
                    again, left = True, 0
                    strikes -= 1
                    continue
                if n > 0 or rubs or held:
                    c0, c1, c2 = common_velocity(P, xi, 0)
                    for k in range(3):
                        i = k - 1 if k else 2
                        vf[i] = u[k] - (R[i, 0] * c0 + R[i, 1] * c1 + R[i, 2] * c2)
                    for x in range(nx):
                        vf[3 + x] = xi[x]
                steady, again = not whole, False
                if touched:
                    for i in range(n):
                        c = chosen[i]
                        lam_n[toss, step, c] += V[LAM, 3 * i]
                        carried[c] += V[LAM, 3 * i]
                        vn = u_before[0]
                        for x in range(nx):
                            vn += tau[c, 0, x] * before[x]
                        steady = steady and abs(vn) < STEADY
                if touched and not steady:
                    integrate_configuration(q, vf, h, moved)
                else:
                    for i in range(nv):
                        mean[i] = 0.5 * (v[i] + vf[i])
                    integrate_configuration(q, mean, h, moved)
                size = 0.0
                for i in range(nq):
                    size += abs(moved[i])
                for i in range(nv):
                    size += abs(vf[i])
                if not (good and size < 1e9):
                    finite[toss] = False
                    break
                if status != 0:
                    unsolved[toss] += 1
                worst[toss] = max(worst[toss], kkt_error)
                q[:] = moved
                v[:] = vf
                left -= 1
                if left <= 0:
                    done, left = done + 1, 0
                    if not whole:
                        rest -= h
                        done = substeps if rest < 1e-9 * dt else 0
            if not finite[toss]:
                break
            reached = step + 1
            for i in range(nq):
                qs[toss, reached, i] = q[i]
            for i in range(nv):
                vs[toss, reached, i] = v[i]
        for rest_of in range(reached + 1, qs.shape[1]):
            qs[toss, rest_of] = qs[toss, reached]
            vs[toss, rest_of] = vs[toss, reached]
