"""Time stepping of a single body: the scheme of `stepping`, in one kernel over scalars.

About the centre of mass the mass matrix is constant and block diagonal, so with
d a corner's place from there, a = R^T u the contact direction u in the body's
axes, tau = d x a and I^-1 = L L^T:

    u . velocity of the corner = u . v_com + tau . omega
    Delassus matrix entry      = u_i . u_j / m + G_i . G_j,   G = L^T tau

Nothing is factorised in a step. Directions are the world's z, x, y, so that a is
a row of R and u_i . u_j is 0 or 1. The answers are those of the tree's kernel to
rounding (tests/physics/test_body.py). Forces of the state and laws of contact beyond
a constant friction are in `forces`.
"""

from __future__ import annotations

import math

import numpy as np

from tossid.kernels import kernel
from tossid.physics.body_step import delassus, first_impact, turned
from tossid.physics.contact import (
    BOUNCE_SPEED,
    CLOSING_SPEED,
    IMPACT_SPEED,
    MAX_ITERATIONS,
    QUIET,
    RECOVERY_SPEED,
    RESTING,
    STEADY,
    STRIKE,
    TOUCHING,
    UNKNOWN,
    above_ground,
    kept_speed,
    recovery_time,
    solve_exact,
)
from tossid.physics.forces import SPIN, damped, friction_of, grown, hold, push, resist_spin
from tossid.physics.impacts import carry_over
from tossid.physics.network import network
from tossid.physics.solvers.cone_qp import qp_solve
from tossid.physics.solvers.workspace import LAM, MU, B


@kernel
def simulate_body(  # type: ignore[no-untyped-def]
    mass, com, inertia, inverse, root, corner, arm, mu, restitution, compliance, relaxation, cohesion, gravity,
    forced, forces, lawful, law, linear, W0, b0, W1, b1, W2,
    q0, v0, n_steps, dt, substeps, impact_parts, tolerance, first, last,
    qs, vs, lam_n, unsolved, worst, finite, V, index,
):  # fmt: skip
    """Simulate tosses first..last-1; arguments and results as in `stepping`. V, index: from `cone_work(n_c)`."""
    nc = mu.shape[0]
    h = loaded = dt / substeps  # of a step, and of that whose impulses are in `warm`
    over_m = 1.0 / mass
    added = law.added_mass if lawful else 0.0
    soft = compliance / (h * recovery_time(h, compliance, relaxation, added))
    keeps, keeps_across = kept_speed(h, compliance, relaxation, added)
    rigid = compliance == 0.0 and relaxation == 0.0
    radius = law.rounding if lawful else 0.0
    whole = impact_parts == 1 or not rigid  # steps do not end at impacts
    learned = linear.shape[0] > 0
    held = lawful and (law.torsional != 0.0 or law.rolling != 0.0 or law.adhesion != 0.0)
    turn = damped(inertia, 0.5 * h * forces.spin) if forced else inverse
    f, h0, h1, extra = np.empty(9), np.empty(b0.shape[0]), np.empty(b0.shape[0]), np.zeros(6)
    height, sunk = np.empty(nc), np.empty(nc)
    spin, less = np.empty(3), np.empty(3)  # less: what contact's resistance takes from it in a strike
    carried = np.zeros(nc)  # normal impulses over the parts of a step
    state, chosen = np.zeros(nc, np.int64), np.zeros(nc, np.int64)
    tau, G, A = np.empty((nc, 3, 3)), np.empty((3 * nc, 3)), np.empty((3 * nc, 3 * nc))
    warm, R = np.zeros((nc, 3)), np.empty((3, 3))
    axis = np.array([2, 0, 1])  # the world axis of a contact's rows: normal, t1, t2
    c0, c1, c2 = com[0], com[1], com[2]
    for toss in range(first, last):
        p0, p1, p2 = q0[toss, 0], q0[toss, 1], q0[toss, 2]
        a, b, d, e = q0[toss, 3], q0[toss, 4], q0[toss, 5], q0[toss, 6]
        v_0, v_1, v_2 = v0[toss, 0], v0[toss, 1], v0[toss, 2]
        w0, w1, w2 = v0[toss, 3], v0[toss, 4], v0[toss, 5]
        cold = nc > 0  # not a literal, of which numba would compile a second version
        sunk[:] = UNKNOWN
        for i in range(7):
            qs[toss, 0, i] = q0[toss, i]
        for i in range(6):
            vs[toss, 0, i] = v0[toss, i]
        reached, quiet = 0, 0
        for step in range(n_steps[toss]):
            done, left = 0, 0
            rest, strikes, again = dt, np.int64(0), False
            while done < substeps:
                r00, r01, r02 = 1.0 - 2.0 * (d * d + e * e), 2.0 * (b * d - a * e), 2.0 * (b * e + a * d)
                r10, r11, r12 = 2.0 * (b * d + a * e), 1.0 - 2.0 * (b * b + e * e), 2.0 * (d * e - a * b)
                r20, r21, r22 = 2.0 * (b * e - a * d), 2.0 * (d * e + a * b), 1.0 - 2.0 * (b * b + d * d)
                R[0, 0], R[0, 1], R[0, 2] = r00, r01, r02
                R[1, 0], R[1, 1], R[1, 2] = r10, r11, r12
                R[2, 0], R[2, 1], R[2, 2] = r20, r21, r22
                strike = False
                if impact_parts > 1 and left == 0:
                    parts, strike, length = first_impact(
                        corner, arm, r20, r21, r22, p2 - radius, v_2, w0, w1, w2, gravity[2], sunk, rigid,
                        strikes, impact_parts, rest, dt / substeps,
                    )  # fmt: skip
                    if strike:
                        strikes += 1
                    else:
                        loaded = carry_over(warm, carried, length, loaded, rigid)
                    if strike:
                        length = STRIKE * dt
                    if length != h:
                        h = length
                        soft = compliance / (h * recovery_time(h, compliance, relaxation, added))
                        keeps, keeps_across = kept_speed(h, compliance, relaxation, added)
                        turn = damped(inertia, 0.5 * h * forces.spin) if forced else inverse
                    left = parts
                    carried[:] = 0.0
                # free motion: Newton and Euler about the centre of mass, then the origin's velocity
                l0 = inertia[0, 0] * w0 + inertia[0, 1] * w1 + inertia[0, 2] * w2
                l1 = inertia[1, 0] * w0 + inertia[1, 1] * w1 + inertia[1, 2] * w2
                l2 = inertia[2, 0] * w0 + inertia[2, 1] * w1 + inertia[2, 2] * w2
                t0, t1, t2 = w2 * l1 - w1 * l2, w0 * l2 - w2 * l0, w1 * l0 - w0 * l1
                if forced:
                    drag = forces.spin * grown(forces, SPIN, w0, w1, w2)
                    t0, t1, t2 = t0 - drag * w0, t1 - drag * w1, t2 - drag * w2
                    if forces.powered == SPIN:
                        turn = damped(inertia, 0.5 * h * drag)
                g0 = turn[0, 0] * t0 + turn[0, 1] * t1 + turn[0, 2] * t2
                g1 = turn[1, 0] * t0 + turn[1, 1] * t1 + turn[1, 2] * t2
                g2 = turn[2, 0] * t0 + turn[2, 1] * t1 + turn[2, 2] * t2
                s0, s1, s2 = w1 * c2 - w2 * c1, w2 * c0 - w0 * c2, w0 * c1 - w1 * c0
                e0 = g1 * c2 - g2 * c1 + w1 * s2 - w2 * s1
                e1 = g2 * c0 - g0 * c2 + w2 * s0 - w0 * s2
                e2 = g0 * c1 - g1 * c0 + w0 * s1 - w1 * s0
                if learned:
                    f[0], f[1], f[2] = r20, r21, r22
                    speed = math.sqrt(v_0 * v_0 + v_1 * v_1 + v_2 * v_2)
                    f[3] = speed * (r00 * v_0 + r10 * v_1 + r20 * v_2)
                    f[4] = speed * (r01 * v_0 + r11 * v_1 + r21 * v_2)
                    f[5] = speed * (r02 * v_0 + r12 * v_1 + r22 * v_2)
                    f[6], f[7], f[8] = 0.1 * w0, 0.1 * w1, 0.1 * w2
                    network(linear, W0, b0, W1, b1, W2, f, h0, h1, extra)
                    e0, e1, e2 = e0 - extra[0], e1 - extra[1], e2 - extra[2]
                    g0, g1, g2 = g0 + extra[3], g1 + extra[4], g2 + extra[5]
                x0 = v_0 + h * (gravity[0] - (r00 * e0 + r01 * e1 + r02 * e2))
                x1 = v_1 + h * (gravity[1] - (r10 * e0 + r11 * e1 + r12 * e2))
                x2 = v_2 + h * (gravity[2] - (r20 * e0 + r21 * e1 + r22 * e2))
                y0, y1, y2 = w0 + h * g0, w1 + h * g1, w2 + h * g2
                if forced:
                    m0, m1, m2 = push(
                        forces, gravity, over_m, h, R, com, p0, p1, p2, v_0, v_1, v_2, w0, w1, w2, y0, y1, y2
                    )
                    x0, x1, x2 = x0 + m0, x1 + m1, x2 + m2
                if held and not strike:
                    x0, x1, x2, y0, y1, y2 = hold(
                        law, inverse, over_m, h, R, com, arm, p2 - radius, warm, cold, x0, x1, x2, y0, y1, y2
                    )

                if again:
                    y0, y1, y2 = y0 + less[0], y1 + less[1], y2 + less[2]
                    s0, s1, s2 = less[1] * c2 - less[2] * c1, less[2] * c0 - less[0] * c2, less[0] * c1 - less[1] * c0
                    x0 -= r00 * s0 + r01 * s1 + r02 * s2
                    x1 -= r10 * s0 + r11 * s1 + r12 * s2
                    x2 -= r20 * s0 + r21 * s1 + r22 * s2

                # which corners could be hit
                reach = 0.02 + 3.0 * h * (abs(x2) + 0.2 * (abs(y0) + abs(y1) + abs(y2)))
                low = False
                for c in range(nc):
                    z = p2 - radius + r20 * corner[0, c] + r21 * corner[1, c] + r22 * corner[2, c]
                    z = above_ground(z, c, sunk, rigid, h)
                    if strike and z < TOUCHING:
                        z = 0.0
                    elif rigid and z < 0.0:
                        z *= h / max(h, dt / substeps)  # comes out within a whole step
                    elif z < TOUCHING and not whole:
                        z = min(z, RECOVERY_SPEED * h)  # is on the ground, and recovers there
                    height[c] = z
                    low = low or z < reach
                touched, status, kkt_error, n = False, 0, 0.0, np.int64(0)
                u0, u1, u2, n0, n1, n2, f0, f1, f2 = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
                if low:
                    # velocities of the centre of mass, free (u) and before the step (k)
                    s0, s1, s2 = y1 * c2 - y2 * c1, y2 * c0 - y0 * c2, y0 * c1 - y1 * c0
                    u0 = x0 + r00 * s0 + r01 * s1 + r02 * s2
                    u1 = x1 + r10 * s0 + r11 * s1 + r12 * s2
                    u2 = x2 + r20 * s0 + r21 * s1 + r22 * s2
                    s0, s1, s2 = w1 * c2 - w2 * c1, w2 * c0 - w0 * c2, w0 * c1 - w1 * c0
                    k0 = v_0 + (r00 * s0 + r01 * s1 + r02 * s2)
                    k1 = v_1 + (r10 * s0 + r11 * s1 + r12 * s2)
                    k2 = v_2 + (r20 * s0 + r21 * s1 + r22 * s2)
                    for c in range(nc):
                        state[c] = 0
                        if height[c] < reach:
                            d0, d1, d2 = arm[c, 0] - radius * r20, arm[c, 1] - radius * r21, arm[c, 2] - radius * r22
                            for k in range(3):
                                i = axis[k]
                                tau[c, k, 0] = d1 * R[i, 2] - d2 * R[i, 1]
                                tau[c, k, 1] = d2 * R[i, 0] - d0 * R[i, 2]
                                tau[c, k, 2] = d0 * R[i, 1] - d1 * R[i, 0]
                            vn = u2 + tau[c, 0, 0] * y0 + tau[c, 0, 1] * y1 + tau[c, 0, 2] * y2
                            state[c] = 2 if height[c] / h + vn < CLOSING_SPEED else 1
                    for _attempt in range(4):
                        n, closed = np.int64(0), True  # not a literal, of which numba would compile a second version
                        for c in range(nc):
                            if state[c] != 2:
                                continue
                            r = 3 * n
                            for k in range(3):
                                m0, m1, m2 = tau[c, k, 0], tau[c, k, 1], tau[c, k, 2]
                                V[B, r + k] = m0 * y0 + m1 * y1 + m2 * y2
                                V[LAM, r + k] = 0.0 if cold or strike else warm[c, k]
                                G[r + k, 0] = root[0, 0] * m0 + root[1, 0] * m1 + root[2, 0] * m2
                                G[r + k, 1] = root[1, 1] * m1 + root[2, 1] * m2
                                G[r + k, 2] = root[2, 2] * m2
                            free, lasts = V[B, r] + u2, 0.0
                            target = height[c] / h + free
                            if restitution > 0.0 and target < 0.0:
                                before = k2 + tau[c, 0, 0] * w0 + tau[c, 0, 1] * w1 + tau[c, 0, 2] * w2
                                if before < -BOUNCE_SPEED and (strike or whole or before > -IMPACT_SPEED):
                                    target = min(target, free + restitution * before)
                            elif target < 0.0 or height[c] < 0.0:
                                target = height[c] / recovery_time(h, compliance, relaxation, added) + free
                                if keeps > 0.0:
                                    before = k2 + tau[c, 0, 0] * w0 + tau[c, 0, 1] * w1 + tau[c, 0, 2] * w2
                                    target -= keeps * before
                                    lasts = keeps_across
                            V[B, r] = target
                            V[B, r + 1] += u0
                            V[B, r + 2] += u1
                            grip = mu[c]
                            if lawful:
                                slip1 = k0 + tau[c, 1, 0] * w0 + tau[c, 1, 1] * w1 + tau[c, 1, 2] * w2
                                slip2 = k1 + tau[c, 2, 0] * w0 + tau[c, 2, 1] * w1 + tau[c, 2, 2] * w2
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
                            n = np.int64(0)
                            break
                        delassus(G, n, over_m, soft, A)
                        lifts = False
                        if lawful and law.lifting > 0.0:
                            for c in range(nc):
                                lifts = lifts or (state[c] == 2 and height[c] < law.lifting)
                        if lifts:
                            status, kkt_error, _ = qp_solve(A, V, index, n, tolerance, MAX_ITERATIONS)
                        else:
                            status, kkt_error = solve_exact(A, V, index, n, tolerance)
                        f0, f1, f2, m0, m1, m2 = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
                        touched = False
                        for i in range(n):
                            r = 3 * i  # type: ignore[assignment]
                            i0, i1, i2 = V[LAM, r], V[LAM, r + 1], V[LAM, r + 2]
                            if i0 != 0.0 or i1 != 0.0 or i2 != 0.0:
                                touched = True
                                f0, f1, f2 = f0 + i1, f1 + i2, f2 + i0
                                m0 += G[r, 0] * i0 + G[r + 1, 0] * i1 + G[r + 2, 0] * i2
                                m1 += G[r, 1] * i0 + G[r + 1, 1] * i1 + G[r + 2, 1] * i2
                                m2 += G[r, 2] * i0 + G[r + 1, 2] * i1 + G[r + 2, 2] * i2
                        n0 = y0 + root[0, 0] * m0
                        n1 = y1 + root[1, 0] * m0 + root[1, 1] * m1
                        n2 = y2 + root[2, 0] * m0 + root[2, 1] * m1 + root[2, 2] * m2
                        hit = False
                        for c in range(nc):
                            if state[c] == 1:
                                vn = u2 + over_m * f2 + tau[c, 0, 0] * n0 + tau[c, 0, 1] * n1 + tau[c, 0, 2] * n2
                                if height[c] / h + vn < 0.0:
                                    state[c] = 2
                                    hit = True
                        if not hit:
                            break
                if n > 0:
                    if not strike:
                        for c in range(nc):
                            warm[c, 0], warm[c, 1], warm[c, 2] = 0.0, 0.0, 0.0
                        for i in range(n):
                            for k in range(3):
                                warm[chosen[i], k] = V[LAM, 3 * i + k]
                        cold = False
                    elif held and not again:  # what resists spin hangs on the impulse, and the impulse on it
                        m0 = 0.0
                        for i in range(n):
                            m0 += V[LAM, 3 * i]
                        spin[0], spin[1], spin[2] = n0, n1, n2
                        resist_spin(law, m0, inverse, R, spin)
                        less[0], less[1], less[2] = spin[0] - n0, spin[1] - n1, spin[2] - n2
                        again, left = True, 0
                        strikes -= 1
                        continue
                    s0, s1, s2 = n1 * c2 - n2 * c1, n2 * c0 - n0 * c2, n0 * c1 - n1 * c0
                    x0 = u0 + over_m * f0 - (r00 * s0 + r01 * s1 + r02 * s2)
                    x1 = u1 + over_m * f1 - (r10 * s0 + r11 * s1 + r12 * s2)
                    x2 = u2 + over_m * f2 - (r20 * s0 + r21 * s1 + r22 * s2)
                    y0, y1, y2 = n0, n1, n2
                else:
                    cold = True
                steady, again = not whole, False
                if touched:
                    for i in range(n):
                        lam_n[toss, step, chosen[i]] += V[LAM, 3 * i]
                        carried[chosen[i]] += V[LAM, 3 * i]
                        vn = k2 + tau[chosen[i], 0, 0] * w0 + tau[chosen[i], 0, 1] * w1 + tau[chosen[i], 0, 2] * w2
                        steady = steady and abs(vn) < STEADY
                if touched and not steady:
                    m0, m1, m2, f0, f1, f2 = x0, x1, x2, y0, y1, y2
                else:
                    m0, m1, m2 = 0.5 * (v_0 + x0), 0.5 * (v_1 + x1), 0.5 * (v_2 + x2)
                    f0, f1, f2 = 0.5 * (w0 + y0), 0.5 * (w1 + y1), 0.5 * (w2 + y2)
                if not abs(x0) + abs(x1) + abs(x2) + abs(y0) + abs(y1) + abs(y2) + abs(p0) + abs(p1) + abs(p2) < 1e9:
                    finite[toss] = False
                    break
                # along the velocity
                p0, p1, p2 = p0 + h * m0, p1 + h * m1, p2 + h * m2
                a, b, d, e = turned(a, b, d, e, 0.5 * h * f0, 0.5 * h * f1, 0.5 * h * f2)
                v_0, v_1, v_2, w0, w1, w2 = x0, x1, x2, y0, y1, y2
                if status != 0:
                    unsolved[toss] += 1
                if kkt_error > worst[toss]:
                    worst[toss] = kkt_error
                speed = abs(x0) + abs(x1) + abs(x2) + abs(y0) + abs(y1) + abs(y2)
                quiet = quiet + 1 if rigid and touched and speed < RESTING * tolerance else 0
                left -= 1
                if left <= 0:
                    done, left = done + 1, 0
                    if not whole:
                        rest -= h
                        done = substeps if rest < 1e-9 * dt else 0
            if not finite[toss]:
                break
            reached = step + 1
            qs[toss, reached, 0], qs[toss, reached, 1], qs[toss, reached, 2] = p0, p1, p2
            qs[toss, reached, 3], qs[toss, reached, 4], qs[toss, reached, 5], qs[toss, reached, 6] = a, b, d, e
            vs[toss, reached, 0], vs[toss, reached, 1], vs[toss, reached, 2] = v_0, v_1, v_2
            vs[toss, reached, 3], vs[toss, reached, 4], vs[toss, reached, 5] = w0, w1, w2
            if quiet >= QUIET:  # it stays where it is, by the same impulses
                for rest in range(reached, n_steps[toss]):
                    for c in range(nc):
                        lam_n[toss, rest, c] = warm[c, 0] * dt / loaded
                break
        for rest in range(reached + 1, qs.shape[1]):
            for i in range(7):
                qs[toss, rest, i] = qs[toss, reached, i]
            for i in range(6):
                vs[toss, rest, i] = vs[toss, reached, i]
