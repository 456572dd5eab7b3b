"""The implicit loss of `implicit` and its gradient, transition by transition (Numba).

With twists and wrenches about the bodies' origins nothing of the size of a contact Jacobian
is stored. For a corner at r (world axes, from its body's origin), a body's twist (w, u) = X v
gives the corner's velocity J v = u + w x r, and its impulse f the wrench (r x f, f).

With y = W miss / m and z = M^-1 y (m the total mass, p = M^-1 J^T lam, a_0 = M^-1 k),

    d prediction = -z . (dt dk - dM (dt a_0 + p) + dJ^T lam + J_t^T dlam_t) - dt y . da_res

where dlam_t = (lam_t / mu) dmu. The other terms depend on corners and friction alone.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tossid.models.implicit_motion import (
    Array,
    add_wrench,
    body_motion,
    body_twist,
    cross,
    dot,
    factor,
    free_motion,
    jit,
    mass_matrix,
    multiply_lower,
    solve,
    solve_columns,
    to_body,
    to_world,
    world_twists,
)
from tossid.physics.solvers import work_arrays
from tossid.physics.solvers.cone_qp import qp_at_rest, qp_solve
from tossid.physics.solvers.workspace import LAM, MAX_ITERATIONS, MU, NOT_FINITE, SOLVED, TOP, B

PREDICTION, COMPLEMENTARITY, DISSIPATION, PENETRATION = 0, 1, 2, 3
NEXT, FREE, TEST = 0, 1, 2


class Contact(NamedTuple):
    """Corners (n_c,), (n_c, 3), friction, and the terms' weights (4,) with the gap's scale [m]."""

    corner_body: NDArray[np.int64]
    corner_pos: Array
    mu: float
    weights: Array
    gap_scale: float


class Sums(NamedTuple):
    """Sums over transitions: the terms (4,), and their gradients in the numbers of `implicit.Dynamics`, in its order.

    corner_pos (4, n_c, 3) and mu (4,) hold one for each term; the others, in their numbers' own shapes, enter the
    prediction alone. residual has no rows if its gradient is not wanted.
    """

    terms: Array
    mass: Array
    moment: Array
    inertia: Array
    corner_pos: Array
    mu: Array
    gravity: Array
    residual: Array


@jit
def corner_velocity(twist, which, b, r, c):  # type: ignore[no-untyped-def]
    """u + w x r of corner c of body b (world)."""
    w = (twist[which, b, 0], twist[which, b, 1], twist[which, b, 2])
    x = cross(w, (r[c, 0], r[c, 1], r[c, 2]))
    return twist[which, b, 3] + x[0], twist[which, b, 4] + x[1], twist[which, b, 5] + x[2]


@jit
def prepare(motion, n, bodies, metric, gravity, residual, contact, work, V):  # type: ignore[no-untyped-def]
    """Miss without impulses, W, y = W miss; near the ground also the inner problem's c in V[B], and V[MU].

    Returns sum |c_i|.
    """
    free_motion(motion, n, bodies, gravity, residual, work, work.miss)
    for j in range(len(work.miss)):
        work.miss[j] = motion.dv[n, j] - motion.dt[n] * work.miss[j]
    mass_matrix(motion.X, n, metric, work.S, work.W)
    multiply_lower(work.W, work.miss, work.y)
    size = 0.0
    if not motion.near[n]:
        return size
    for j in range(len(work.z)):
        work.z[j] = work.y[j]
    solve(work.L, work.z)
    world_twists(motion.X, motion.R, n, work.z, work.twist, FREE)
    world_twists(motion.X, motion.R, n, motion.v_next[n], work.twist, NEXT)
    r, pos, mu, scale = work.r, contact.corner_pos, contact.mu, contact.gap_scale
    normal, tangent = contact.weights[COMPLEMENTARITY], contact.weights[DISSIPATION]
    for c in range(len(pos)):
        b = contact.corner_body[c]
        p = (pos[c, 0], pos[c, 1], pos[c, 2])
        r[c, 0], r[c, 1], r[c, 2] = to_world(motion.R, n, b, p)
        up = (motion.up_next[n, b, 0], motion.up_next[n, b, 1], motion.up_next[n, b, 2])
        work.phi[c] = motion.z_next[n, b] + dot(up, p)
        work.gap[c] = (math.sqrt(work.phi[c] * work.phi[c] + scale * scale) - scale) / motion.dt[n]
        s = corner_velocity(work.twist, NEXT, b, r, c)
        speed = math.sqrt(s[0] * s[0] + s[1] * s[1] + 1e-16)
        work.slide[c, 0], work.slide[c, 1], work.slide[c, 2] = s[0], s[1], speed
        w = corner_velocity(work.twist, FREE, b, r, c)
        V[B, 3 * c] = normal * work.gap[c] + tangent * mu * speed - w[2]
        V[B, 3 * c + 1] = tangent * s[0] - w[0]
        V[B, 3 * c + 2] = tangent * s[1] - w[1]
        V[MU, c] = mu
        size += abs(V[B, 3 * c]) + abs(V[B, 3 * c + 1]) + abs(V[B, 3 * c + 2])
    return size


@jit
def inner_matrix(motion, n, contact, work, A):  # type: ignore[no-untyped-def]
    """A (3 n_c, 3 n_c) = J M^-1 W M^-1 J^T, contact-major (normal first). After `prepare`."""
    X, C, Y, H, W = motion.X, work.C, work.Y, work.H, work.W
    nv, m = X.shape[3], H.shape[1]
    factor(W, C)
    for k in range(nv):
        C[k, k] = 1.0 / C[k, k]
        for i in range(k):
            C[i, k] = 0.0
    solve_columns(work.L, C)
    for b in range(X.shape[1]):
        for k in range(nv):
            w0, w1, w2, u0, u1, u2 = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
            for j in range(nv):
                w0 += X[n, b, 0, j] * C[j, k]
                w1 += X[n, b, 1, j] * C[j, k]
                w2 += X[n, b, 2, j] * C[j, k]
                u0 += X[n, b, 3, j] * C[j, k]
                u1 += X[n, b, 4, j] * C[j, k]
                u2 += X[n, b, 5, j] * C[j, k]
            w, u = to_world(motion.R, n, b, (w0, w1, w2)), to_world(motion.R, n, b, (u0, u1, u2))
            for i in range(3):
                Y[b, i, k], Y[b, 3 + i, k] = w[i], u[i]
    for c in range(len(work.r)):
        b = contact.corner_body[c]
        for k in range(nv):
            x = cross((Y[b, 0, k], Y[b, 1, k], Y[b, 2, k]), (work.r[c, 0], work.r[c, 1], work.r[c, 2]))
            H[k, 3 * c] = Y[b, 5, k] + x[2]
            H[k, 3 * c + 1] = Y[b, 3, k] + x[0]
            H[k, 3 * c + 2] = Y[b, 4, k] + x[1]
    for i in range(m):
        h0, h1, h2, h3, h4, h5 = H[0, i], H[1, i], H[2, i], H[3, i], H[4, i], H[5, i]
        for j in range(m):
            A[i, j] = h0 * H[0, j] + h1 * H[1, j] + h2 * H[2, j] + h3 * H[3, j] + h4 * H[4, j] + h5 * H[5, j]
        for k in range(6, nv):
            h0 = H[k, i]
            for j in range(m):
                A[i, j] += h0 * H[k, j]


@jit
def apply_impulses(motion, n, contact, work, V):  # type: ignore[no-untyped-def]
    """work.push = p = M^-1 J^T lam of V[LAM], and the miss less p."""
    work.wrench[:] = 0.0
    work.push[:] = 0.0
    for c in range(len(work.r)):
        f = (V[LAM, 3 * c + 1], V[LAM, 3 * c + 2], V[LAM, 3 * c])
        b, torque = contact.corner_body[c], cross((work.r[c, 0], work.r[c, 1], work.r[c, 2]), f)
        for i in range(3):
            work.wrench[b, i] += torque[i]
            work.wrench[b, 3 + i] += f[i]
    for b in range(len(work.wrench)):
        q = work.wrench
        torque = to_body(motion.R, n, b, (q[b, 0], q[b, 1], q[b, 2]))
        add_wrench(motion.X, n, b, torque, to_body(motion.R, n, b, (q[b, 3], q[b, 4], q[b, 5])), work.push)
    solve(work.L, work.push)
    for j in range(len(work.push)):
        work.miss[j] -= work.push[j]
    multiply_lower(work.W, work.miss, work.y)


@jit
def inertial_gradient(motion, n, bodies, gravity, work, sums):  # type: ignore[no-untyped-def]
    """Add the prediction's gradient in mass, moment, inertia and gravity; work.push is dt a_0 + p, work.z is set."""
    dt = motion.dt[n]
    for b in range(motion.X.shape[1]):
        m, h, acc, w, alpha = body_motion(motion, n, b, bodies, gravity)
        zw, zu = body_twist(motion.X, n, b, work.z)
        xw, xu = body_twist(motion.X, n, b, work.push)
        zww = cross(zw, w)
        sums.mass[b] += dot(zu, xu) + dt * dot(zu, acc)
        first, second = cross(xu, zw), cross(xw, zu)
        turning, spinning, falling = cross(zu, alpha), cross(cross(zu, w), w), cross(acc, zw)
        zh = cross(zw, h)
        for i in range(3):
            sums.moment[b, i] += first[i] - second[i] + dt * (turning[i] + spinning[i] + falling[i])
            for j in range(3):
                sums.inertia[b, i, j] += zw[i] * xw[j] + dt * (zw[i] * alpha[j] + zww[i] * w[j])
        pull = to_world(motion.R, n, b, (m * zu[0] + zh[0], m * zu[1] + zh[1], m * zu[2] + zh[2]))
        for i in range(3):
            sums.gravity[i] -= dt * pull[i]


@jit
def contact_terms(motion, n, contact, total, work, V, sums, gradient):  # type: ignore[no-untyped-def]
    """Add the terms of contact, and on demand all gradients in corners and friction; `TEST` twists are set for that."""
    mu, dt, R = contact.mu, motion.dt[n], motion.R
    weight_n, weight_t = contact.weights[COMPLEMENTARITY] / total, contact.weights[DISSIPATION] / total
    weight_p = contact.weights[PENETRATION]
    for c in range(len(work.r)):
        b, phi = contact.corner_body[c], work.phi[c]
        lam_n, lam_1, lam_2 = V[LAM, 3 * c], V[LAM, 3 * c + 1], V[LAM, 3 * c + 2]
        s1, s2, speed = work.slide[c, 0], work.slide[c, 1], work.slide[c, 2]
        depth = min(phi, 0.0) / dt
        sums.terms[COMPLEMENTARITY] += weight_n * lam_n * work.gap[c]
        sums.terms[DISSIPATION] += weight_t * (mu * lam_n * speed + lam_1 * s1 + lam_2 * s2)
        sums.terms[PENETRATION] += 0.5 * weight_p * depth * depth
        if not gradient:
            continue
        if depth < 0.0:
            for i in range(3):
                sums.corner_pos[PENETRATION, c, i] += weight_p * depth / dt * motion.up_next[n, b, i]
        if lam_n == 0.0:
            continue
        slope = weight_n * lam_n * phi / math.sqrt(phi * phi + contact.gap_scale * contact.gap_scale) / dt
        z, v, twist = work.twist[TEST, b], work.twist[NEXT, b], work.twist
        by_prediction = to_body(R, n, b, cross((z[0], z[1], z[2]), (lam_1, lam_2, lam_n)))
        share = weight_t * mu * lam_n / speed
        along = (weight_t * lam_1 + share * s1, weight_t * lam_2 + share * s2, 0.0)
        by_dissipation = to_body(R, n, b, cross(along, (v[0], v[1], v[2])))
        for i in range(3):
            sums.corner_pos[PREDICTION, c, i] += by_prediction[i]
            sums.corner_pos[COMPLEMENTARITY, c, i] += slope * motion.up_next[n, b, i]
            sums.corner_pos[DISSIPATION, c, i] += by_dissipation[i]
        if mu > 0.0:
            u = corner_velocity(twist, TEST, b, work.r, c)
            sums.mu[PREDICTION] -= (u[0] * lam_1 + u[1] * lam_2) / mu
            sums.mu[DISSIPATION] += weight_t * (lam_n * speed + (lam_1 * s1 + lam_2 * s2) / mu)


@jit
def loss_sums(  # type: ignore[no-untyped-def]
    motion, bodies, metric, gravity, residual, contact, rows, given, tolerance, max_iterations, work, sums,
    inertial, touching,
):  # fmt: skip
    """Add the loss of some transitions, and on demand its gradient, to `sums`.

    Args:
        rows: (K,) transitions. given: (K, 3 n_c) their impulses, contact-major; solved for if it has no rows.
        tolerance, max_iterations: of the inner problem.
        inertial: gradients in mass, moment, inertia and gravity. touching: in corners and friction.

    Returns:
        status (K,) of the inner problems. Where it is MAX_ITERATIONS, nothing was added.
    """
    nc, nv = len(contact.corner_pos), motion.X.shape[3]
    V, index = work_arrays(nc)
    A = V[TOP + 3 * nc :]
    status = np.zeros(len(rows), dtype=np.uint8)
    total = metric.mass.sum()
    for k in range(len(rows)):
        n = rows[k]
        size = prepare(motion, n, bodies, metric, gravity, residual, contact, work, V)
        near, pushed = motion.near[n], False
        if near:
            for j in range(3 * nc):
                V[LAM, j] = given[k, j] if len(given) else 0.0
            pushed = len(given) > 0
            if not pushed:
                if not size < math.inf:
                    status[k] = NOT_FINITE
                elif not qp_at_rest(V, nc):
                    inner_matrix(motion, n, contact, work, A)
                    status[k], _, _ = qp_solve(A, V, index, nc, tolerance, max_iterations)
                    if status[k] == MAX_ITERATIONS:
                        continue
                    pushed = status[k] == SOLVED
                    if not pushed:
                        for j in range(3 * nc):
                            V[LAM, j] = 0.0
        if pushed:
            apply_impulses(motion, n, contact, work, V)
        elif inertial:
            work.push[:] = 0.0
        prediction = 0.0
        for j in range(nv):
            prediction += work.miss[j] * work.y[j]
            work.y[j] /= total
            work.z[j] = work.y[j]
        sums.terms[PREDICTION] += 0.5 * prediction / total
        if inertial or (touching and pushed):
            solve(work.L, work.z)
        if near:
            if touching and pushed:
                world_twists(motion.X, motion.R, n, work.z, work.twist, TEST)
            contact_terms(motion, n, contact, total, work, V, sums, touching)
        if inertial:
            for j in range(nv):
                work.push[j] += motion.dt[n] * work.a0[j]
            inertial_gradient(motion, n, bodies, gravity, work, sums)
        if len(sums.residual):
            turned = to_body(motion.R, n, 0, (work.y[0], work.y[1], work.y[2]))
            for j in range(nv):
                sums.residual[n, j] = -motion.dt[n] * (turned[j] if j < 3 else work.y[j])
    return status


@jit
def inner_problem(motion, bodies, metric, gravity, residual, contact, n, work):  # type: ignore[no-untyped-def]
    """The inner problem (A, c) of transition n, contact-major."""
    nc = len(contact.corner_pos)
    V, _ = work_arrays(nc)
    A = np.empty((3 * nc, 3 * nc))
    prepare(motion, n, bodies, metric, gravity, residual, contact, work, V)
    inner_matrix(motion, n, contact, work, A)
    return A, V[B, : 3 * nc].copy()
