"""The time-stepping kernel: the scheme of `stepping` for any model (`moving`), law of contact and contact solver."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tossid.kernels import inlined_kernel, kernel
from tossid.physics.contact.holding import adhere, spins_taken
from tossid.physics.contact.impacts import STEADY, carry_over, first_impact
from tossid.physics.contact.law import UNKNOWN
from tossid.physics.contact.problem import find_corners, find_gaps, find_rows, velocity
from tossid.physics.contact.resolve import keep_warm, resolve_contact
from tossid.physics.moving import (
    accelerate,
    act_on_free,
    common_velocity,
    kinematics,
    n_rates,
)
from tossid.physics.network import network
from tossid.physics.solvers.workspace import LAM

Array = NDArray[np.float64]

STRIKE = 1e-6
"""Length of a strike, over a frame's: an impulse, and no way.

Not a setting: any number gives the same that is small beside 1 and large beside rounding.
"""
RESTING, QUIET = 100.0, 4
"""Speed [m/s] and spin [rad/s] in sum, over the solver's tolerance, below which a body in rigid contact is at rest
after so many steps. What gives way creeps on, and is followed."""
REPEATS = 2
"""Times that a step is solved again for resistance to spin, which hangs on the step's own load, and half as often for
cohesion, which does so too. Where steps do not end at impacts, the last step's load stands for it."""
RUNAWAY = 1e9
"""Sum of a state's numbers above which the toss has left all bounds."""


class StepSettings(NamedTuple):
    """How time is stepped; `simulate` says what each is.

    Attributes:
        dt: time between frames [s].
        substeps: steps in a frame.
        impact_parts: more than 1 for impacts where they happen.
        tolerance: on the contact problem's KKT error [m/s].
    """

    dt: float
    substeps: int
    impact_parts: int
    tolerance: float


class Tosses(NamedTuple):
    """Initial states and lengths of tosses.

    Attributes:
        q: (B, nq) configurations.
        v: (B, nv) velocities.
        n_steps: (B,) frames to simulate.
    """

    q: Array
    v: Array
    n_steps: NDArray[np.int64]


class Simulation(NamedTuple):
    """Simulated tosses. A toss whose state becomes infinite, or whose M is not positive, stays at its last finite one.

    Attributes:
        q: (B, T + 1, nq) configurations; frames past a toss's own number of steps hold its last state.
        v: (B, T + 1, nv) velocities.
        lam_n: (B, T, n_c) normal impulse of each corner over the frame [N s].
        unsolved: (B,) steps whose contact problem missed the tolerance.
        kkt_error: (B,) the largest KKT error of a step's contact problem [m/s].
        finite: (B,) False where a state became NaN or infinite, or M lost its definiteness.
    """

    q: Array
    v: Array
    lam_n: Array
    unsolved: NDArray[np.int64]
    kkt_error: Array
    finite: NDArray[np.bool_]


@inlined_kernel
def turned(a, b, d, e, x, y, z):  # type: ignore[no-untyped-def]
    """Quaternion (a, b, d, e) times exp(x, y, z), half a rotation vector: by series for the small angles of a step."""
    angle = x * x + y * y + z * z
    if angle < 0.04:
        s = 1.0 - angle / 6.0 * (1.0 - angle / 20.0 * (1.0 - angle / 42.0 * (1.0 - angle / 72.0)))
        co = 1.0 - angle / 2.0 * (
            1.0 - angle / 12.0 * (1.0 - angle / 30.0 * (1.0 - angle / 56.0 * (1.0 - angle / 90.0)))
        )
    else:
        angle = math.sqrt(angle)
        s, co = math.sin(angle) / angle, math.cos(angle)
    x, y, z = s * x, s * y, s * z
    w0, w1 = a * co - b * x - d * y - e * z, a * x + b * co + d * z - e * y
    w2, w3 = a * y - b * z + d * co + e * x, a * z + b * y - d * x + e * co
    s = 1.0 / math.sqrt(w0 * w0 + w1 * w1 + w2 * w2 + w3 * w3)
    return s * w0, s * w1, s * w2, s * w3


@inlined_kernel
def rotation(q, R):  # type: ignore[no-untyped-def]
    """R (3, 3) of the quaternion q[3:7]."""
    a, b, d, e = q[3], q[4], q[5], q[6]
    R[0, 0], R[0, 1], R[0, 2] = 1.0 - 2.0 * (d * d + e * e), 2.0 * (b * d - a * e), 2.0 * (b * e + a * d)
    R[1, 0], R[1, 1], R[1, 2] = 2.0 * (b * d + a * e), 1.0 - 2.0 * (b * b + e * e), 2.0 * (d * e - a * b)
    R[2, 0], R[2, 1], R[2, 2] = 2.0 * (b * e - a * d), 2.0 * (d * e + a * b), 1.0 - 2.0 * (b * b + d * d)


@inlined_kernel
def add_learned(k_res, s, nx):  # type: ignore[no-untyped-def]
    """Add the learned acceleration (`free.features`) to s.a and s.rate; at once again where they are found anew."""
    R, q, v, f = s.R, s.q, s.v, s.feature
    speed = math.sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2])
    for i in range(3):
        f[i] = R[2, i]
        f[3 + i] = speed * (R[0, i] * v[0] + R[1, i] * v[1] + R[2, i] * v[2])
        f[6 + i] = 0.1 * v[3 + i]
    for j in range(nx - 3):
        f[9 + 3 * j], f[10 + 3 * j], f[11 + 3 * j] = math.sin(q[7 + j]), math.cos(q[7 + j]), 0.1 * v[6 + j]
    n = 3 * nx
    if k_res.linear.shape[0] > n:
        f[n + 6] = 1.0
        for i in range(3):
            f[n + i], f[n + 3 + i] = R[0, i], R[1, i]
            f[n + 7 + i], f[n + 10 + i] = q[i], v[i]
    network(k_res, f, s.hidden, s.learned)
    for i in range(3):
        s.a[i] -= s.learned[i]
    for x in range(nx):
        s.rate[x] += s.learned[3 + x]
    for k in range(k_res.linear.shape[1] - 3 - nx):  # along the world's axes
        for i in range(3):
            s.a[i] -= R[k, i] * s.learned[3 + nx + k]


@inlined_kernel
def start_velocity(model, work, s):  # type: ignore[no-untyped-def]
    """s.u_start of s.v and s.xi_start: the common centre of mass moves with the origin and what the rates add."""
    R = s.R
    c0, c1, c2 = common_velocity(model, work, s.xi_start, 0)
    for k in range(3):
        i = k - 1 if k else 2
        s.u_start[k] = s.v[i] + (R[i, 0] * c0 + R[i, 1] * c1 + R[i, 2] * c2)


@inlined_kernel
def free_velocity(model, work, s, h):  # type: ignore[no-untyped-def]
    """v_free = v + h (g - R a) and xi_free = xi + h d xi / dt into s.v_next, s.xi, and s.u of the centre of mass."""
    R, nx = s.R, n_rates(model)
    for i in range(3):
        pulled = R[i, 0] * s.a[0] + R[i, 1] * s.a[1] + R[i, 2] * s.a[2]
        s.v_next[i] = s.v[i] + h * (model.gravity[i] - pulled)
    for x in range(nx):
        s.v_next[3 + x] = s.xi_start[x] + h * s.rate[x]
        s.xi[x] = s.v_next[3 + x]
    if model.acts:
        act_on_free(model, work, s, h)
    c0, c1, c2 = common_velocity(model, work, s.v_next, 3)
    for k in range(3):
        i = k - 1 if k else 2
        s.u[k] = s.v_next[i] + R[i, 0] * c0 + R[i, 1] * c1 + R[i, 2] * c2


@inlined_kernel
def origin_velocity(model, work, s):  # type: ignore[no-untyped-def]
    """s.v_next of s.u and s.xi: the base's origin moves with u less what the rates add at the common centre of mass."""
    R = s.R
    c0, c1, c2 = common_velocity(model, work, s.xi, 0)
    for k in range(3):
        i = k - 1 if k else 2
        s.v_next[i] = s.u[k] - (R[i, 0] * c0 + R[i, 1] * c1 + R[i, 2] * c2)
    for x in range(n_rates(model)):
        s.v_next[3 + x] = s.xi[x]


@inlined_kernel
def drift(q, v, h, nx, out):  # type: ignore[no-untyped-def]
    """out = q moved along v for a time h; out may be q."""
    for i in range(3):
        out[i] = q[i] + h * v[i]
    out[3], out[4], out[5], out[6] = turned(q[3], q[4], q[5], q[6], 0.5 * h * v[3], 0.5 * h * v[4], 0.5 * h * v[5])
    for j in range(nx - 3):
        out[7 + j] = q[7 + j] + h * v[6 + j]


@inlined_kernel
def between(old, new, mean):  # type: ignore[no-untyped-def]
    """The mean of two numbers if `mean`, else the new one."""
    return 0.5 * (old + new) if mean else new


@inlined_kernel
def move(model, s, h, mean):  # type: ignore[no-untyped-def]
    """s.q_next: s.q moved along v' or, if `mean`, along (v + v') / 2, for a time h. Whether the state is in bounds."""
    q, v, v_next, q_next, size = s.q, s.v, s.v_next, s.q_next, 0.0
    for i in range(3):
        q_next[i] = q[i] + h * between(v[i], v_next[i], mean)
    x, y, z = between(v[3], v_next[3], mean), between(v[4], v_next[4], mean), between(v[5], v_next[5], mean)
    q_next[3], q_next[4], q_next[5], q_next[6] = turned(q[3], q[4], q[5], q[6], 0.5 * h * x, 0.5 * h * y, 0.5 * h * z)
    for j in range(n_rates(model) - 3):
        q_next[7 + j] = q[7 + j] + h * between(v[6 + j], v_next[6 + j], mean)
    for i in range(4 + n_rates(model)):
        size += abs(q_next[i])
    for i in range(3 + n_rates(model)):
        size += abs(v_next[i])
    return size < RUNAWAY


@kernel(allocates=False)
def simulate_tosses(model, law, k_res, solver, settings, tosses, out, work, s, corners, first, last):  # type: ignore[no-untyped-def]
    """Simulate tosses first..last-1 into `out`, a `stepping.Simulation`.

    Args:
        model: `Body` or `Links`.
        law: `ContactLaw`.
        k_res: `Network`.
        solver: of contact, registered.
        settings: `StepSettings`.
        tosses: `Tosses`.
        out: `Simulation`.
        work: scratch of the model.
        s: `State`.
        corners: `Corners`.
        first: of the tosses.
        last: the one after the last.
    """
    dt, substeps, impact_parts, tolerance = settings
    nq, nv, nc, nx = tosses.q.shape[1], tosses.v.shape[1], law.mu.shape[0], n_rates(model)
    V, chosen, warm = corners.V, corners.chosen, corners.warm
    beyond, learned = law.beyond, k_res.linear.shape[1] > 0
    rigid, cut = law.compliance == 0.0 and law.relaxation == 0.0, impact_parts > 1
    whole = not (cut and rigid)  # steps do not end at impacts
    central = cut and rigid and beyond.lifting == 0.0  # contact acts along the directions of a step's middle
    adhesive, resists = beyond.adhesion != 0.0, beyond.torsional != 0.0 or beyond.rolling != 0.0
    coheres, held = law.cohesion > 0.0, adhesive or resists
    h = loaded = dt / substeps  # of a step, and of that whose impulses are in `warm`
    for toss in range(first, last):
        for i in range(nq):
            s.q[i] = out.q[toss, 0, i] = tosses.q[toss, i]
        for i in range(nv):
            s.v[i] = out.v[toss, 0, i] = tosses.v[toss, i]
        cold = nc > 0  # not a literal, of which numba would compile a second version
        for c in range(nc):
            corners.sunk[c] = UNKNOWN
        reached, quiet, uneven = 0, 0, nc > 0
        for step in range(tosses.n_steps[toss]):
            done, left, rest, strikes, again = 0, 0, dt, np.int64(0), 0
            while done < substeps:
                for x in range(nx):
                    s.xi_start[x] = s.v[3 + x]
                begins, strike, halfway = cut and left == 0, False, False
                if begins:
                    h = dt / substeps
                    if rigid:
                        h = rest / max(1.0, math.ceil(rest / h - 1e-6))
                low, known = False, False  # known: how long the step is, and where in it forces are found
                while True:
                    rotation(s.q, s.R)
                    kinematics(model, work, s)
                    good = accelerate(model, work, s, h)
                    if learned:
                        add_learned(k_res, s, nx)
                    start_velocity(model, work, s)
                    if known:
                        break
                    low = find_corners(model, work, s, corners, beyond.rounding, h)
                    if not begins:
                        break
                    left, strike, length, lands = first_impact(
                        model, law, work, s, corners, rigid, strikes, impact_parts, h
                    )
                    halfway = not (strike or lands) and (central if low else learned or model.pose_matters)
                    if strike:
                        strikes += 1
                        length = STRIKE * dt
                    else:
                        loaded = carry_over(corners, length, loaded, rigid)
                    for c in range(nc):
                        corners.carried[c] = 0.0
                    known = halfway or (model.h_matters and length != h)
                    h = length
                    if halfway:
                        for i in range(nq):
                            s.q_next[i] = s.q[i]
                        drift(s.q, s.v, 0.5 * h, nx, s.q)
                    if not known:
                        break
                if low:
                    find_rows(model, work, s, corners, beyond.rounding)
                free_velocity(model, work, s, h)
                if (low or uneven) and again == 0:
                    uneven = find_gaps(model, law, work, s, corners, rigid, strike, whole, halfway, h, dt / substeps)
                if adhesive and not strike:
                    adhere(model, law, work, s, corners, h, cold)
                if (resists or coheres) and again == 0:
                    for c in range(nc):
                        corners.load[c] = 0.0 if cold else warm[c, 0]
                if resists and again == 0:
                    spins_taken(model, law, work, s, corners, not (cold or strike))
                if resists:
                    for x in range(nx):
                        s.xi[x] += s.taken[x]
                n, touched, status, kkt_error = np.int64(0), False, 0, 0.0
                if low:
                    n, touched, status, kkt_error = resolve_contact(
                        model, law, solver, work, s, corners, h, tolerance, cold, strike, strike or whole, halfway
                    )
                repeats = 0
                if resists:
                    repeats = 1 if strike else 0 if whole else REPEATS
                elif coheres and not (strike or whole):
                    repeats = REPEATS // 2
                if (resists or coheres) and (n == 0 or again < repeats):
                    if resists:
                        for x in range(nx):
                            s.xi[x] -= s.taken[x]
                    if n > 0:  # what resists spin and cohesion hang on the load, and the load on them
                        for c in range(nc):
                            corners.load[c] = 0.0
                        for i in range(n):
                            corners.load[chosen[i]] = V[LAM, 3 * i]
                        if resists:
                            spins_taken(model, law, work, s, corners, True)
                        if halfway:
                            for i in range(nq):
                                s.q[i] = s.q_next[i]
                        again, left = again + 1, 0
                        strikes -= 1 if strike else 0
                        continue
                if n == 0:
                    cold = True
                elif not strike:
                    keep_warm(corners, n)
                    cold = False
                if n > 0 or model.acts or held:
                    origin_velocity(model, work, s)
                steady, again = not whole, 0
                if touched:
                    for i in range(n):
                        c = chosen[i]
                        out.lam_n[toss, step, c] += V[LAM, 3 * i]
                        corners.carried[c] += V[LAM, 3 * i]
                        steady = steady and abs(velocity(corners.tau, c, 0, s.u_start, s.xi_start, nx)) < STEADY
                moved = move(model, s, 0.5 * h, False) if halfway else move(model, s, h, not touched or steady)
                if not (moved and good):
                    out.finite[toss] = False
                    break
                speed = 0.0
                for i in range(nx + 4):
                    s.q[i] = s.q_next[i]
                for i in range(nx + 3):
                    s.v[i] = s.v_next[i]
                    speed += abs(s.v[i])
                if status != 0:
                    out.unsolved[toss] += 1
                if kkt_error > out.kkt_error[toss]:
                    out.kkt_error[toss] = kkt_error
                quiet = quiet + 1 if model.rests and rigid and touched and speed < RESTING * tolerance else 0
                left -= 1
                if left <= 0:
                    done, left = done + 1, 0
                    if not whole:
                        rest -= h
                        done = substeps if rest < 1e-9 * dt else 0
            if not out.finite[toss]:
                break
            reached = step + 1
            for i in range(nq):
                out.q[toss, reached, i] = s.q[i]
            for i in range(nv):
                out.v[toss, reached, i] = s.v[i]
            if quiet >= QUIET:  # it stays where it is, by the same impulses
                for later in range(reached, tosses.n_steps[toss]):
                    for c in range(nc):
                        out.lam_n[toss, later, c] = warm[c, 0] * dt / loaded
                break
        for later in range(reached + 1, out.q.shape[1]):
            for i in range(nq):
                out.q[toss, later, i] = out.q[toss, reached, i]
            for i in range(nv):
                out.v[toss, later, i] = out.v[toss, reached, i]
