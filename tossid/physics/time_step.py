"""The time step: docs/method/scheme.md for any model (`moving`), law of contact and contact solver.

`advance_frame` asks for the `next_event`, has `contact_solve` find the impulses of a `free_step` or a `strike`, and
`integrate`s. Numbers of equations are those of that page.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tossid.kernels import inlined_kernel, kernel, lean_kernel
from tossid.physics.contact.holding import adhere, find_spin_taken
from tossid.physics.contact.impacts import STEADY, carry_over, first_impact
from tossid.physics.contact.law import ContactLaw
from tossid.physics.contact.problem import (
    begin_toss,
    find_corners,
    find_gaps,
    find_gaps_of_strike,
    find_rows,
    gives_way,
    keep_warm,
    make_corners,
    velocity,
)
from tossid.physics.contact.resolve import resolve_contact
from tossid.physics.moving import make_state, n_rates
from tossid.physics.network import Network
from tossid.physics.solvers.workspace import LAM
from tossid.physics.step_motion import drift, find_accelerations, free_velocity, move, origin_velocity

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


class Engine(NamedTuple):
    """What moves a toss on.

    Attributes:
        model: `Body` or `Links`.
        law: of contact.
        k_res: the learned acceleration.
        solver: of contact, registered.
        settings: of time stepping.
        at_impacts: whether steps end where rigid contact begins.
    """

    model: Any
    law: ContactLaw
    k_res: Network
    solver: Any
    settings: StepSettings
    at_impacts: bool


class Step(NamedTuple):
    """What is to happen next.

    Attributes:
        h: length of the step [s].
        parts: such steps one after another, before the next event is looked for.
        strike: whether it is an impulse, of no length.
        midpoint: whether `State` is that of the step's middle.
        low: whether a corner is within reach of the ground.
        regular: whether the mass matrix is positive.
    """

    h: float
    parts: int
    strike: bool
    midpoint: bool
    low: bool
    regular: bool


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


@kernel
def simulate_part(engine, tosses, out, work, first, last):  # type: ignore[no-untyped-def]
    """`simulate_tosses` with its own scratch: to hand thirty more arrays to a kernel takes longer than one motion."""
    nv = tosses.v.shape[1]
    corners = make_corners(engine.law.mu.shape[0], nv - 3)
    state = make_state(tosses.q.shape[1], nv, engine.k_res.b0.shape[0])
    simulate_tosses(engine, tosses, out, work, state, corners, first, last)


@lean_kernel
def simulate_tosses(engine, tosses, out, work, s, corners, first, last):  # type: ignore[no-untyped-def]
    """Simulate tosses first..last-1 into `out`, a `Simulation`.

    Args:
        engine: `Engine`.
        tosses: `Tosses`.
        out: `Simulation`.
        work: scratch of the model.
        s: `State`.
        corners: `Corners`.
        first: of the tosses.
        last: the one after the last.
    """
    dt = engine.settings.dt
    for toss in range(first, last):
        for i in range(s.q.shape[0]):
            s.q[i] = tosses.q[toss, i]
        for i in range(s.v.shape[0]):
            s.v[i] = tosses.v[toss, i]
        begin_toss(corners, dt / engine.settings.substeps)
        record_state(s, out, toss, 0)
        frame = quiet = 0
        while frame < tosses.n_steps[toss] and quiet < QUIET:
            quiet = advance_frame(engine, work, s, corners, out, toss, frame, quiet)
            if not out.finite[toss]:
                break
            frame += 1
            record_state(s, out, toss, frame)
        for later in range(frame, tosses.n_steps[toss] if quiet >= QUIET else frame):  # at rest, by the same impulses
            for c in range(corners.state.shape[0]):
                out.lam_n[toss, later, c] = corners.warm[c, 0] * dt / corners.span[0]
        for later in range(frame + 1, out.q.shape[1]):
            for i in range(s.q.shape[0]):
                out.q[toss, later, i] = out.q[toss, frame, i]
            for i in range(s.v.shape[0]):
                out.v[toss, later, i] = out.v[toss, frame, i]


@inlined_kernel
def record_state(s, out, toss, frame):  # type: ignore[no-untyped-def]
    """The state becomes that of a frame."""
    for i in range(s.q.shape[0]):
        out.q[toss, frame, i] = s.q[i]
    for i in range(s.v.shape[0]):
        out.v[toss, frame, i] = s.v[i]


@inlined_kernel
def advance_frame(engine, work, s, corners, out, toss, frame, quiet):  # type: ignore[no-untyped-def]
    """Step on until the next frame; a toss that leaves all bounds is noted in out.finite.

    quiet: steps after which the object has been at rest so far. Returns the same at the frame's end.
    """
    settings, law = engine.settings, engine.law
    rest, strikes = settings.dt, 0
    step = Step(settings.dt / settings.substeps, 1, False, False, False, True)
    while rest > 1e-9 * settings.dt:
        step = next_event(engine, work, s, corners, step, rest, strikes)
        n, touched, status, kkt_error = contact_solve(engine, work, s, corners, step)
        if not integrate(engine, work, s, corners, step, n, touched, out, toss, frame):
            out.finite[toss] = False
            break
        out.unsolved[toss] += 1 if status != 0 else 0
        out.kkt_error[toss] = max(out.kkt_error[toss], kkt_error)
        still = engine.model.rests and law.rigid and touched and speed_of(s) < RESTING * settings.tolerance
        quiet = quiet + 1 if still else 0
        strikes += 1 if step.strike else 0
        rest -= step.h
    return quiet


@inlined_kernel
def next_event(engine, work, s, corners, step, rest, strikes):  # type: ignore[no-untyped-def]
    """The next step of a frame of which `rest` [s] is left: a whole one, one to an impact (eq. 5), or a strike.

    Leaves the accelerations at the step's start or, if it is one of the midpoint rule (eq. 7), at its middle. They are
    found in a loop of one or two turns: what is inlined at two places is compiled twice.

    step: the last one; if it has further parts, the next of them follows. strikes: in this frame so far.
    """
    model, law, settings = engine.model, engine.law, engine.settings
    h, parts, struck, midpoint, low = step.h, step.parts - 1, False, False, False
    decided = parts > 0 or settings.impact_parts == 1
    if parts == 0:
        parts, h = 1, settings.dt / settings.substeps
        if engine.at_impacts:
            h = rest / max(1.0, math.ceil(rest / h - 1e-6))
    again, first, regular = True, True, True
    while again:
        again = False
        regular = find_accelerations(model, engine.k_res, work, s, h)
        if first:
            low = find_corners(model, work, s, corners, law.beyond.rounding, h)
        if not decided:
            decided, first = True, False
            parts, struck, length, lands = first_impact(model, law, work, s, corners, strikes, settings.impact_parts, h)
            midpoint = not (struck or lands) and uses_midpoint(engine, low)
            if struck:
                length = STRIKE * settings.dt
            else:
                carry_over(corners, length, law.rigid)
            for c in range(corners.state.shape[0]):
                corners.carried[c] = 0.0
            again = midpoint or (model.h_matters and length != h)
            h = length
            if midpoint:
                for i in range(s.q.shape[0]):
                    s.q_next[i] = s.q[i]
                drift(s.q, s.v, s.v, False, 0.5 * h, n_rates(model), s.q)
    return Step(h, parts, struck, midpoint, low, regular)


@inlined_kernel
def uses_midpoint(engine, low):  # type: ignore[no-untyped-def]
    """Whether a step without an impact goes by the midpoint rule: in rigid contact, in flight if the pose matters."""
    if low:
        return engine.at_impacts and engine.law.beyond.lifting == 0.0
    return engine.k_res.linear.shape[1] > 0 or engine.model.pose_matters


@inlined_kernel
def free_step(engine, work, s, corners, step):  # type: ignore[no-untyped-def]
    """The gaps that a step of some length has to keep open (eq. 4, 7), after the free velocity."""
    if step.low or gives_way(corners):
        whole = engine.settings.dt / engine.settings.substeps
        find_gaps(engine.model, engine.law, work, s, corners, engine.at_impacts, step.midpoint, step.h, whole)


@inlined_kernel
def strike(engine, corners, step):  # type: ignore[no-untyped-def]
    """The gaps of an impulse at once: what touches is on the ground (eq. 6)."""
    find_gaps_of_strike(engine.law, corners, step.h)


@inlined_kernel
def contact_solve(engine, work, s, corners, step):  # type: ignore[no-untyped-def]
    """Impulses (eq. 4) and what else contact holds (eq. 12, 13): s.u and s.xi become those after the step.

    Resistance to spin and cohesion hang on the load, and the load on them. Both are first by the load of the step
    before. Where steps end at impacts, the step is then solved again with its own.

    Returns:
        (candidates, 0 if none is hit; touched; status; KKT error).
    """
    model, law, beyond = engine.model, engine.law, engine.law.beyond
    resists = beyond.torsional != 0.0 or beyond.rolling != 0.0
    n, touched, status, kkt_error, left = 0, False, 0, 0.0, repeats(engine, step, resists)
    if step.low:
        find_rows(model, work, s, corners, beyond.rounding)
    for turn in range(1 + left):
        free_velocity(model, work, s, step.h)
        if turn == 0:
            if step.strike:
                strike(engine, corners, step)
            else:
                free_step(engine, work, s, corners, step)
            if resists or law.cohesion > 0.0:
                for c in range(corners.state.shape[0]):
                    corners.load[c] = corners.warm[c, 0]
        if beyond.adhesion != 0.0 and not step.strike:
            adhere(model, law, work, s, corners, step.h)
        if resists:
            if turn == 0:
                find_spin_taken(model, law, work, s, corners, not step.strike)
            add_spin_taken(s, 1.0)
        if step.low:
            n, touched, status, kkt_error = resolve_contact(
                model, law, engine.solver, work, s, corners, step,
                step.strike or not engine.at_impacts, engine.settings.tolerance,
            )  # fmt: skip
        if resists and (n == 0 or turn < left):
            add_spin_taken(s, -1.0)
        if n == 0:
            break
        if turn < left:
            find_load(corners, n)
            if resists:
                find_spin_taken(model, law, work, s, corners, True)
    return n, touched, status, kkt_error


@inlined_kernel
def repeats(engine, step, resists):  # type: ignore[no-untyped-def]
    """How often a step's contact problem is solved again with its own load."""
    if resists:
        return 0 if not engine.at_impacts else 1 if step.strike else REPEATS
    return REPEATS // 2 if engine.law.cohesion > 0.0 and engine.at_impacts and not step.strike else 0


@inlined_kernel
def add_spin_taken(s, sign):  # type: ignore[no-untyped-def]
    """Take from s.xi what resistance to spin takes (sign 1), or give it back (-1)."""
    for x in range(s.xi.shape[0]):
        s.xi[x] += sign * s.taken[x]


@inlined_kernel
def find_load(corners, n):  # type: ignore[no-untyped-def]
    """The corners' loads by the n candidates' impulses."""
    for c in range(corners.load.shape[0]):
        corners.load[c] = 0.0
    for i in range(n):
        corners.load[corners.chosen[i]] = corners.V[LAM, 3 * i]


@inlined_kernel
def integrate(engine, work, s, corners, step, n, touched, out, toss, frame):  # type: ignore[no-untyped-def]
    """Move on (eq. 2) by the velocity after the step, and add the n candidates' impulses to the frame's in `out`.

    Returns whether the state is within all bounds.
    """
    model, beyond = engine.model, engine.law.beyond
    if not step.strike or n == 0:
        keep_warm(corners, n)
    if n > 0 or model.acts or beyond.adhesion != 0.0 or beyond.torsional != 0.0 or beyond.rolling != 0.0:
        origin_velocity(model, work, s)
    steady = engine.at_impacts  # what slides or turns, and does not land, moves by the mean of both velocities
    if touched:
        for i in range(n):
            c = corners.chosen[i]
            out.lam_n[toss, frame, c] += corners.V[LAM, 3 * i]
            corners.carried[c] += corners.V[LAM, 3 * i]
            steady = steady and abs(velocity(corners.tau, c, 0, s.u_start, s.xi_start, n_rates(model))) < STEADY
    mean = not step.midpoint and (not touched or steady)
    if not (move(model, s, 0.5 * step.h if step.midpoint else step.h, mean) and step.regular):
        return False
    for i in range(s.q.shape[0]):
        s.q[i] = s.q_next[i]
    for i in range(s.v.shape[0]):
        s.v[i] = s.v_next[i]
    return True


@inlined_kernel
def speed_of(s):  # type: ignore[no-untyped-def]
    """Sum of the velocity's sizes [m/s, rad/s]."""
    speed = 0.0
    for i in range(s.v.shape[0]):
        speed += abs(s.v[i])
    return speed
