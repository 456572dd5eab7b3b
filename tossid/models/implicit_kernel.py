"""The implicit loss of `implicit` and its gradient, transition by transition (Numba).

With twists and wrenches about the bodies' origins nothing of the size of a contact Jacobian
is stored. For a corner at r (world axes, from its body's origin), a body's twist (w, u) = X v
gives the corner's velocity J v = u + w x r, and its impulse f the wrench (r x f, f).

With the residual r = dv - dt a - M^-1 J^T lam, y = W r / m and z = M^-1 y (m the total mass, p = M^-1 J^T lam,
a_0 = M^-1 k),

    d prediction = -z . (dt dk - dM (dt a_0 + p) + dJ^T lam + J_t^T dlam_t) - dt y . da_res

where dlam_t = (lam_t / mu) dmu. The other terms depend on corners and friction alone.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tossid.kernels import fused_kernel
from tossid.models.implicit_motion import (
    A0,
    ACCEL,
    ALPHA,
    BASE,
    BODY,
    FREE,
    GAP,
    HALF,
    HEIGHT,
    METRIC,
    NEXT,
    PHI,
    PLACE,
    POS,
    PUSH,
    RESIDUAL,
    SLIDE,
    SPEED,
    SPIN,
    TEST,
    TURN,
    UP,
    WEIGHT,
    WRENCH,
    Array,
    Kinematics,
    Y,
    Z,
    add_a_res,
    add_wrench,
    body_twist,
    cross,
    dot,
    free_motion,
    get,
    half_response,
    load,
    mass_matrix,
    product,
    put,
    solve,
    to_body,
    weigh,
    world_twists,
)
from tossid.physics.contact.rounds import Points, Shape, is_round, lowest_offset
from tossid.physics.solvers.cone_qp import qp_at_rest, qp_solve
from tossid.physics.solvers.workspace import LAM, MAX_ITERATIONS, MU, NOT_FINITE, SOLVED, TOP, B, work_arrays

PREDICTION, COMPLEMENTARITY, DISSIPATION, PENETRATION = 0, 1, 2, 3


class Contact(NamedTuple):
    """The corners and the weights of the terms.

    Attributes:
        corner_body: (n_c,) body of each corner.
        mu: Friction.
        complementarity: Weight of impulses at a distance.
        dissipation: Weight of friction that does not oppose sliding.
        penetration: Weight of corners below the ground.
        gap_scale: Distance below which a gap counts quadratically [m].
        shape: What stands at the corners.
    """

    corner_body: NDArray[np.int64]
    mu: float
    complementarity: float
    dissipation: float
    penetration: float
    gap_scale: float
    shape: Shape = Points()


class Problem(NamedTuple):
    """What the loss is a function of.

    Attributes:
        kin: The transitions.
        gravity: (3,) of k_hat [m/s²].
        a_res: (N, nv) learned acceleration in the base's frame, or no rows.
        contact: The corners and the weights.
    """

    kin: Kinematics
    gravity: Array
    a_res: Array
    contact: Contact


class Sums(NamedTuple):
    """Sums over transitions: the terms, and their gradients in the numbers of `implicit.Dynamics`, in its order.

    Attributes:
        terms: (4,) prediction, complementarity, dissipation, penetration.
        mass: (n_b,), of the prediction alone, as the next two, `gravity` and `a_res`.
        moment: (n_b, 3).
        inertia: (n_b, 3, 3).
        corner_pos: (4, n_c, 3), one for each term.
        mu: (4,), one for each term.
        gravity: (3,).
        a_res: (N, nv); no rows if it is not wanted.
    """

    terms: Array
    mass: Array
    moment: Array
    inertia: Array
    corner_pos: Array
    mu: Array
    gravity: Array
    a_res: Array


@fused_kernel
def corner_velocity(P, b, at, Q, c):  # type: ignore[no-untyped-def]
    """Velocity u + w x r of corner c of body b (world), for the body's twist at column `at`."""
    x = cross(get(P, b, at), get(Q, c, PLACE))
    return P[b, at + 3] + x[0], P[b, at + 4] + x[1], P[b, at + 5] + x[2]


@fused_kernel
def prepare(problem, n, work):  # type: ignore[no-untyped-def]
    """The transition in scratch; U[RESIDUAL] = dv - dt a without impulses, and U[Y]."""
    P, G, U, X, kin = work.P, work.G, work.U, work.X, problem.kin
    load(kin, n, problem.gravity, P, X)
    free_motion(P, X, G, U)
    for j in range(U.shape[1]):
        U[RESIDUAL, j] = kin.dv[n, j] - kin.dt[n] * U[A0, j]
    add_a_res(P, problem.a_res, n, U, RESIDUAL, -kin.dt[n])
    mass_matrix(P, METRIC, X, G, WEIGHT)
    weigh(G, U)


@fused_kernel
def prepare_contact(v_next, n, dt, contact, work, V):  # type: ignore[no-untyped-def]
    """The corners' gaps and sliding; the inner problem's linear part into V[B], friction into V[MU].

    Returns a sum that is finite if the numbers are. After `prepare`.
    """
    P, Q, U = work.P, work.Q, work.U
    for j in range(U.shape[1]):
        U[Z, j] = v_next[n, j]
    world_twists(P, work.X, U, Z, NEXT)
    for j in range(U.shape[1]):
        U[Z, j] = U[Y, j]
    solve(work.G, U, Z)
    world_twists(P, work.X, U, Z, FREE)
    mu, scale, size = contact.mu, contact.gap_scale, 0.0
    for c in range(len(Q)):
        b, k = contact.corner_body[c], 3 * c
        pos = get(Q, c, POS)
        if is_round(contact.shape):  # the point that is lowest before the step is hit, and that after it has the gap
            before = lowest_offset(contact.shape, c, P[b, TURN + 6], P[b, TURN + 7], P[b, TURN + 8])
            after = lowest_offset(contact.shape, c, P[b, UP], P[b, UP + 1], P[b, UP + 2])
            put(Q, c, PLACE, product(P, b, TURN, (pos[0] + before[0], pos[1] + before[1], pos[2] + before[2])))
            pos = (pos[0] + after[0], pos[1] + after[1], pos[2] + after[2])
        else:
            put(Q, c, PLACE, product(P, b, TURN, pos))
        phi = P[b, HEIGHT] + dot(get(P, b, UP), pos)
        gap = (math.sqrt(phi * phi + scale * scale) - scale) / dt
        s = corner_velocity(P, b, NEXT, Q, c)
        speed = math.sqrt(s[0] * s[0] + s[1] * s[1] + 1e-16)
        Q[c, SLIDE], Q[c, SLIDE + 1], Q[c, SPEED], Q[c, PHI], Q[c, GAP] = s[0], s[1], speed, phi, gap
        w = corner_velocity(P, b, FREE, Q, c)
        V[B, k] = contact.complementarity * gap + contact.dissipation * mu * speed - w[2]
        V[B, k + 1], V[B, k + 2] = contact.dissipation * s[0] - w[0], contact.dissipation * s[1] - w[1]
        V[MU, c] = mu
        size += abs(V[B, k]) + abs(V[B, k + 1]) + abs(V[B, k + 2])
    return size


@fused_kernel
def inner_matrix(corner_body, P, Q, G, X, XC, H, A):  # type: ignore[no-untyped-def]
    """A (3 n_c, 3 n_c) = J M^-1 W M^-1 J^T, contact-major (normal first). After `prepare_contact`."""
    nv, m = H.shape
    half_response(G)
    for b in range(len(P)):
        for i in range(6):
            for k in range(nv):
                XC[b, i, k] = 0.0
            for j in range(nv):
                for k in range(nv):
                    XC[b, i, k] += X[b, i, j] * G[HALF, j, k]
        for k in range(nv):
            w = product(P, b, TURN, (XC[b, 0, k], XC[b, 1, k], XC[b, 2, k]))
            u = product(P, b, TURN, (XC[b, 3, k], XC[b, 4, k], XC[b, 5, k]))
            for i in range(3):
                XC[b, i, k], XC[b, 3 + i, k] = w[i], u[i]
    for c in range(len(Q)):
        b, r = corner_body[c], get(Q, c, PLACE)
        for k in range(nv):
            x = cross((XC[b, 0, k], XC[b, 1, k], XC[b, 2, k]), r)
            H[k, 3 * c] = XC[b, 5, k] + x[2]
            H[k, 3 * c + 1], H[k, 3 * c + 2] = XC[b, 3, k] + x[0], XC[b, 4, k] + x[1]
    for i in range(m):
        h0, h1, h2, h3, h4, h5 = H[0, i], H[1, i], H[2, i], H[3, i], H[4, i], H[5, i]
        for j in range(m):
            A[i, j] = h0 * H[0, j] + h1 * H[1, j] + h2 * H[2, j] + h3 * H[3, j] + h4 * H[4, j] + h5 * H[5, j]
        for k in range(6, nv):
            h0 = H[k, i]
            for j in range(m):
                A[i, j] += h0 * H[k, j]


@fused_kernel
def apply_impulses(corner_body, P, Q, G, U, X, V):  # type: ignore[no-untyped-def]
    """U[PUSH] = p = M^-1 J^T lam of V[LAM], and U[RESIDUAL] less p."""
    for b in range(len(P)):
        for i in range(6):
            P[b, WRENCH + i] = 0.0
    for c in range(len(Q)):
        f = (V[LAM, 3 * c + 1], V[LAM, 3 * c + 2], V[LAM, 3 * c])
        b, torque = corner_body[c], cross(get(Q, c, PLACE), f)
        for i in range(3):
            P[b, WRENCH + i] += torque[i]
            P[b, WRENCH + 3 + i] += f[i]
    for b in range(len(P)):
        add_wrench(X, b, to_body(P, b, get(P, b, WRENCH)), to_body(P, b, get(P, b, WRENCH + 3)), U, PUSH)
    solve(G, U, PUSH)
    for j in range(U.shape[1]):
        U[RESIDUAL, j] -= U[PUSH, j]
    weigh(G, U)


@fused_kernel
def inertial_gradient(dt, P, X, U, sums):  # type: ignore[no-untyped-def]
    """Add the prediction's gradient in mass, moment, inertia and gravity; U[Z] is set, U[PUSH] becomes dt a_0 + p."""
    for j in range(U.shape[1]):
        U[PUSH, j] += dt * U[A0, j]
    for b in range(len(P)):
        m, h, w, alpha, acc = P[b, BODY], get(P, b, BODY + 1), get(P, b, SPIN), get(P, b, ALPHA), get(P, b, ACCEL)
        zw, zu = body_twist(X, b, U, Z)
        xw, xu = body_twist(X, b, U, PUSH)
        zww, zh = cross(zw, w), cross(zw, h)
        first, second = cross(xu, zw), cross(xw, zu)
        turning, spinning, falling = cross(zu, alpha), cross(cross(zu, w), w), cross(acc, zw)
        sums.mass[b] += dot(zu, xu) + dt * dot(zu, acc)
        for i in range(3):
            sums.moment[b, i] += first[i] - second[i] + dt * (turning[i] + spinning[i] + falling[i])
            for j in range(3):
                sums.inertia[b, i, j] += zw[i] * xw[j] + dt * (zw[i] * alpha[j] + zww[i] * w[j])
        pull = product(P, b, TURN, (m * zu[0] + zh[0], m * zu[1] + zh[1], m * zu[2] + zh[2]))
        for i in range(3):
            sums.gravity[i] -= dt * pull[i]


@fused_kernel
def contact_terms(dt, contact, total, Q, V, terms):  # type: ignore[no-untyped-def]
    """Add the terms of contact."""
    for c in range(len(Q)):
        lam_n, lam_1, lam_2 = V[LAM, 3 * c], V[LAM, 3 * c + 1], V[LAM, 3 * c + 2]
        depth = min(Q[c, PHI], 0.0) / dt
        terms[COMPLEMENTARITY] += contact.complementarity * lam_n * Q[c, GAP] / total
        slip = contact.mu * lam_n * Q[c, SPEED] + lam_1 * Q[c, SLIDE] + lam_2 * Q[c, SLIDE + 1]
        terms[DISSIPATION] += contact.dissipation * slip / total
        terms[PENETRATION] += 0.5 * contact.penetration * depth * depth


@fused_kernel
def contact_gradient(dt, contact, total, P, Q, V, by_corner, by_mu):  # type: ignore[no-untyped-def]
    """Add all terms' gradients in corners and friction; twist TEST is set."""
    mu, weight_t = contact.mu, contact.dissipation / total
    for c in range(len(Q)):
        b, phi, lam_n = contact.corner_body[c], Q[c, PHI], V[LAM, 3 * c]
        up = get(P, b, UP)
        if phi < 0.0:
            for i in range(3):
                by_corner[PENETRATION, c, i] += contact.penetration * phi / (dt * dt) * up[i]
        if lam_n == 0.0:
            continue
        lam_1, lam_2, s1, s2, speed = V[LAM, 3 * c + 1], V[LAM, 3 * c + 2], Q[c, SLIDE], Q[c, SLIDE + 1], Q[c, SPEED]
        slope = contact.complementarity * lam_n * phi / (dt * total)
        slope /= math.sqrt(phi * phi + contact.gap_scale * contact.gap_scale)
        share = mu * lam_n / speed
        along = (weight_t * (lam_1 + share * s1), weight_t * (lam_2 + share * s2), 0.0)
        prediction = to_body(P, b, cross(get(P, b, TEST), (lam_1, lam_2, lam_n)))
        dissipation = to_body(P, b, cross(along, get(P, b, NEXT)))
        for i in range(3):
            by_corner[PREDICTION, c, i] += prediction[i]
            by_corner[COMPLEMENTARITY, c, i] += slope * up[i]
            by_corner[DISSIPATION, c, i] += dissipation[i]
        if mu > 0.0:
            u = corner_velocity(P, b, TEST, Q, c)
            by_mu[PREDICTION] -= (u[0] * lam_1 + u[1] * lam_2) / mu
            by_mu[DISSIPATION] += weight_t * (lam_n * speed + (lam_1 * s1 + lam_2 * s2) / mu)


@fused_kernel
def loss_sums(  # type: ignore[no-untyped-def]
    problem, rows, given, tolerance, max_iterations, work, sums, inertial, touching
):
    """Add the loss of some transitions, and on demand its gradient, to `sums`.

    Args:
        problem: `Problem`.
        rows: (K,) transitions.
        given: (K, 3 n_c) their impulses, contact-major; solved for if it has no rows.
        tolerance: Of the inner problem.
        max_iterations: Of its solver.
        work: Scratch.
        sums: `Sums`, added to.
        inertial: Whether gradients in mass, moment, inertia and gravity are wanted.
        touching: Whether those in corners and friction are.

    Returns:
        status (K,) of the inner problems. Where it is MAX_ITERATIONS, nothing was added.
    """
    P, Q, G, U, X = work.P, work.Q, work.G, work.U, work.X
    kin, contact = problem.kin, problem.contact
    nc, nv = len(Q), X.shape[2]
    V, index = work_arrays(nc)
    A = V[TOP + 3 * nc :]
    status = np.zeros(len(rows), dtype=np.uint8)
    total = 0.0
    for b in range(len(P)):
        total += P[b, METRIC]
    for k in range(len(rows)):
        n = rows[k]
        dt, near = kin.dt[n], kin.near[n]
        pushed = near and len(given) > 0
        prepare(problem, n, work)
        if near:
            size = prepare_contact(kin.v_next, n, dt, contact, work, V)
            for j in range(3 * nc):
                V[LAM, j] = given[k, j] if pushed else 0.0
            if not size < math.inf:
                status[k] = NOT_FINITE
            elif not pushed and not qp_at_rest(V, nc):
                inner_matrix(contact.corner_body, P, Q, G, X, work.XC, work.H, A)
                status[k], _, _ = qp_solve(A, V, index, nc, tolerance, max_iterations)
                if status[k] == MAX_ITERATIONS:
                    continue
                pushed = status[k] == SOLVED
        for j in range(nv):
            U[PUSH, j] = 0.0
        if pushed:
            apply_impulses(contact.corner_body, P, Q, G, U, X, V)
        prediction = 0.0
        for j in range(nv):
            prediction += U[RESIDUAL, j] * U[Y, j]
            U[Y, j] /= total
            U[Z, j] = U[Y, j]
        sums.terms[PREDICTION] += 0.5 * prediction / total
        if near:
            if not pushed:
                for j in range(3 * nc):
                    V[LAM, j] = 0.0
            contact_terms(dt, contact, total, Q, V, sums.terms)
        if inertial or (touching and pushed):
            solve(G, U, Z)
        if touching and near:
            world_twists(P, X, U, Z, TEST)
            contact_gradient(dt, contact, total, P, Q, V, sums.corner_pos, sums.mu)
        if inertial:
            inertial_gradient(dt, P, X, U, sums)
        if len(sums.a_res):
            turned = to_body(P, BASE, get(U, Y, BASE))
            for j in range(nv):
                sums.a_res[n, j] = -dt * (turned[j] if j < 3 else U[Y, j])
    return status


@fused_kernel
def inner_problem(problem, n, work):  # type: ignore[no-untyped-def]
    """The inner problem (A, c) of transition n, contact-major."""
    kin, contact = problem.kin, problem.contact
    nc = len(work.Q)
    V, _ = work_arrays(nc)
    A = np.empty((3 * nc, 3 * nc))
    prepare(problem, n, work)
    prepare_contact(kin.v_next, n, kin.dt[n], contact, work, V)
    inner_matrix(contact.corner_body, work.P, work.Q, work.G, work.X, work.XC, work.H, A)
    return A, V[B, : 3 * nc].copy()
