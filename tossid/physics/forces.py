"""Forces of the state on a single body, and contact beyond a constant friction: what `body` adds to its step.

Forces act at the centre of mass p, with velocity u and world spin omega, and are taken at the step's middle.
With O = magnus / m omega + turning e_z and k the drag per mass at the speed there,

    u' = u + h (g + a(p + h u / 2) + O x U - k U),     U = (u + u') / 2, in magnus and drag less the wind

is second order, conserves the energy of a spring over long times, and is stable for any drag: u' is solved for.
Spin drag is likewise implicit in the mean spin.

What contact adds depends on the contact itself, and is lagged so that the contact problem stays one of constant
friction. All but an impact's resistance to spin, which follows it, is known before the problem is solved:

    speed in friction       the corner's slip at the step's start: before an impact, or at the end of the last step
    direction in friction   the corner's slip without this step's contact forces; that is where the load pushes
    load of resistance      the normal impulse of the step before, over all corners; of an impact, its own
    adhesion                of corners that carried load in the step before or are within `adhesion_reach`
"""

from __future__ import annotations

import math
from enum import IntEnum
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tossid.kernels import inlined_kernel, lean_kernel
from tossid.physics.registered_forces import has_wrench, wrench_of

Array = NDArray[np.float64]


class PoweredForce(IntEnum):
    """The force that is multiplied by a further power of its state: a value of `Forces.powered`."""

    NONE = 0
    DRAG = 1
    SPIN = 2
    MAGNUS = 3
    SPRING = 4
    VORTEX = 5
    TURNING = 6


NONE, DRAG, SPIN, MAGNUS, SPRING, VORTEX, TURNING = map(int, PoweredForce)
"""The same, as kernels compare them."""
LEAST_STATE = 1e-6
"""The least size of a state [SI], whose negative powers are infinite at 0."""


class Forces(NamedTuple):
    """Forces and torques of the state, at the centre of mass, in the world. u, omega: its velocity and spin there.

    Attributes:
        linear: c of the drag -c w, of the velocity w = u - wind [N s/m].
        quadratic: c of the drag -c |w| w [N s²/m²].
        spin: c of the torque -c omega [N m s].
        wind_x: along the world's x [m/s].
        wind_y: along the world's y [m/s].
        magnus: c of the force c omega x w [N s²/m].
        x: a uniform force along the world's x [N].
        y: along y [N].
        z: along z [N].
        spring: stiffness k of the force k (center - p) [N/m].
        center_x: where the spring pulls to [m].
        center_y: [m].
        center_z: [m].
        vortex: c of the force c e_z x p [N/m].
        turning: c of the force m c e_z x u, as in a frame that turns at -c/2 [1/s].
        powered: the force that is multiplied by |state|^power (`PoweredForce`): drag, by the speed in the wind; spin
            drag and Magnus's force, by spin; the spring, by its length; the vortex, by the distance from its axis;
            turning, by speed.
        power: of that force's state, in SI.
    """

    linear: float = 0.0
    quadratic: float = 0.0
    spin: float = 0.0
    wind_x: float = 0.0
    wind_y: float = 0.0
    magnus: float = 0.0
    x: float = 0.0
    y: float = 0.0
    z: float = 0.0
    spring: float = 0.0
    center_x: float = 0.0
    center_y: float = 0.0
    center_z: float = 0.0
    vortex: float = 0.0
    turning: float = 0.0
    powered: float = 0.0
    power: float = 0.0

    @property
    def acts(self) -> bool:
        """Whether anything pulls; wind and the spring's centre alone do not."""
        rest = Forces(
            powered=self.powered,
            power=self.power,
            wind_x=self.wind_x,
            wind_y=self.wind_y,
            center_x=self.center_x,
            center_y=self.center_y,
            center_z=self.center_z,
        )
        return self != rest


class Law(NamedTuple):
    """Contact beyond a constant friction.

    Attributes:
        static_rel: friction at rest over that of fast sliding. At slip speed s it is
            mu (1 + (static_rel - 1) exp(-(s / slip_speed)²)).
        slip_speed: [m/s].
        y_rel: friction along the world's y over that along x; 1 / mu² = d_x² / mu_x² + d_y² / mu_y² for a slip along d.
        torsional: torque per normal force against spin about the vertical [m].
        rolling: torque per normal force against spin about the horizontal [m].
        adhesion: pull of the ground on each touching corner [N].
        lifting: height of a corner below which a step's contact problem is the convex relaxation of Coulomb's law
            (Anitescu 2006), as MuJoCo has it: what slips at s leaves the ground at mu s [m]. 0: Coulomb's law.
        rounding: radius of the corners, spheres that touch the faces of a box with sharp ones [m].
        added_mass: of each corner in contact that yields [kg]: its force is that of its spring and damper, less this
            mass times its acceleration (MuJoCo's 1 / R, by which contact holds most of a load at once).
        margin: height of a corner at the beginning of a step from which on it is not in contact within the step, for
            contact that yields [m]. MuJoCo has 0 by default; without a limit, it is in contact where it comes down.
        impulse_parts: parts in which the impulse of a rigid impact is found, each with friction against the slip as it
            is then (Routh; Keller, "Impact with friction", J. Appl. Mech. 53, 1986). 1: all at once, against the slip
            after the impact.
    """

    static_rel: float = 1.0
    slip_speed: float = 0.1
    y_rel: float = 1.0
    torsional: float = 0.0
    rolling: float = 0.0
    adhesion: float = 0.0
    lifting: float = 0.0
    rounding: float = 0.0
    added_mass: float = 0.0
    margin: float = math.inf
    impulse_parts: float = 1.0

    @property
    def acts(self) -> bool:
        """Whether contact differs from that of a constant friction; the slip speed alone does not."""
        return self != Law(slip_speed=self.slip_speed, impulse_parts=self.impulse_parts)


def forces_of(numbers: Array) -> Forces:
    """The forces that a system's numbers stand for.

    Args:
        numbers: (17,) the fields of `Forces` in their order, or (0,) for none.
    """
    return Forces(*map(float, numbers))


def law_of(numbers: Array) -> Law:
    """The law of contact that a system's numbers stand for.

    Args:
        numbers: (11,) the fields of `Law` in their order, or (0,) for the nominal law.
    """
    return Law(*map(float, numbers))


@lean_kernel
def inverse_damped_inertia(inertia, c, out):  # type: ignore[no-untyped-def]
    """out (3, 3) = (I + c 1)^-1 of an inertia I (3, 3) and a damping c [kg m²], by cofactors."""
    A, scale = inertia, 0.0
    for i in range(3):
        for j in range(3):
            k, l, m, n = (i + 1) % 3, (i + 2) % 3, (j + 1) % 3, (j + 2) % 3
            out[j, i] = (A[k, m] + (c if k == m else 0.0)) * (A[l, n] + (c if l == n else 0.0))
            out[j, i] -= (A[k, n] + (c if k == n else 0.0)) * (A[l, m] + (c if l == m else 0.0))
    for j in range(3):
        scale += (A[0, j] + (c if j == 0 else 0.0)) * out[j, 0]
    for i in range(3):
        for j in range(3):
            out[i, j] /= scale


@lean_kernel
def power_factor(forces, which, x0, x1, x2):  # type: ignore[no-untyped-def]
    """The factor |x|^power of the force `which`, whose state is the vector x; 1 unless it is `forces.powered`."""
    if forces.powered != which:
        return 1.0
    return max(math.sqrt(x0 * x0 + x1 * x1 + x2 * x2), LEAST_STATE) ** forces.power


@inlined_kernel
def to_world(R, x0, x1, x2):  # type: ignore[no-untyped-def]
    """R x, as a tuple of three."""
    return (
        R[0, 0] * x0 + R[0, 1] * x1 + R[0, 2] * x2,
        R[1, 0] * x0 + R[1, 1] * x1 + R[1, 2] * x2,
        R[2, 0] * x0 + R[2, 1] * x1 + R[2, 2] * x2,
    )


@lean_kernel
def velocity_change(forces, registered, gravity, over_m, h, R, position, velocity, spin, spin_after):  # type: ignore[no-untyped-def]
    """What the forces add to the velocity of the centre of mass over a step [m/s, world], beside gravity's h g.

    registered: the user's own force. over_m: 1 / m [1/kg]. R (3, 3): orientation at the start. position, velocity: of
    the centre of mass at the start; spin (body's axes) at the start and, without the forces, at the end; tuples of
    three. The equations are the module's.
    """
    f = forces
    p0, p1, p2 = position
    u0, u1, u2 = velocity
    w0, w1, w2 = spin
    y0, y1, y2 = spin_after
    # at the middle of the step, p + h u / 2: the acceleration a that does not depend on velocity
    half = 0.5 * h
    p0, p1, p2 = p0 + half * u0, p1 + half * u1, p2 + half * u2
    d0, d1, d2 = f.center_x - p0, f.center_y - p1, f.center_z - p2
    spring = f.spring * power_factor(f, SPRING, d0, d1, d2)
    vortex = f.vortex * power_factor(f, VORTEX, p0, p1, 0.0)
    turning = f.turning * power_factor(f, TURNING, u0, u1, u2)
    a0 = gravity[0] + over_m * (f.x + spring * d0 - vortex * p1)
    a1 = gravity[1] + over_m * (f.y + spring * d1 + vortex * p0)
    a2 = gravity[2] + over_m * (f.z + spring * d2)
    if has_wrench(registered):
        middle = (u0 + half * a0, u1 + half * a1, u2 + half * a2)
        (g0, g1, g2), _ = wrench_of(registered, (p0, p1, p2), middle, to_world(R, w0, w1, w2))
        a0, a1, a2 = a0 + over_m * g0, a1 + over_m * g1, a2 + over_m * g2
    # e = u - wind, relative to which turning adds a constant acceleration
    a0, a1 = a0 - turning * f.wind_y, a1 + turning * f.wind_x
    e0, e1, e2 = u0 - f.wind_x, u1 - f.wind_y, u2
    # drag k per mass [1/s], first at the start's speed, then at that of the middle which follows
    k = over_m * (f.linear + f.quadratic * math.sqrt(e0 * e0 + e1 * e1 + e2 * e2)) * power_factor(f, DRAG, e0, e1, e2)
    s = 1.0 / (1.0 + half * k)
    m0, m1, m2 = s * (e0 + half * a0), s * (e1 + half * a1), s * (e2 + half * a2)
    k = over_m * (f.linear + f.quadratic * math.sqrt(m0 * m0 + m1 * m1 + m2 * m2)) * power_factor(f, DRAG, m0, m1, m2)
    # o = h/2 O / (1 + h/2 k), and m: the mean velocity U solves (1 + h/2 k) U - h/2 O x U = e + h/2 a
    s0, s1, s2 = 0.5 * (w0 + y0), 0.5 * (w1 + y1), 0.5 * (w2 + y2)
    b = 1.0 / (1.0 + half * k)
    c = half * b * over_m * f.magnus * power_factor(f, MAGNUS, s0, s1, s2)
    o0 = c * (R[0, 0] * s0 + R[0, 1] * s1 + R[0, 2] * s2)
    o1 = c * (R[1, 0] * s0 + R[1, 1] * s1 + R[1, 2] * s2)
    o2 = c * (R[2, 0] * s0 + R[2, 1] * s1 + R[2, 2] * s2) + half * b * turning
    m0, m1, m2 = b * (e0 + half * a0), b * (e1 + half * a1), b * (e2 + half * a2)
    # (1 - o x) U = m has the solution (m + o x m + o (o . m)) / (1 + |o|²)
    b = 1.0 / (1.0 + o0 * o0 + o1 * o1 + o2 * o2)
    s = o0 * m0 + o1 * m1 + o2 * m2
    s0 = b * (m0 + o1 * m2 - o2 * m1 + o0 * s)
    s1 = b * (m1 + o2 * m0 - o0 * m2 + o1 * s)
    s2 = b * (m2 + o0 * m1 - o1 * m0 + o2 * s)
    # u' - u = 2 (U - e)
    return 2.0 * (s0 - e0) - h * gravity[0], 2.0 * (s1 - e1) - h * gravity[1], 2.0 * (s2 - e2) - h * gravity[2]


@lean_kernel
def friction_of(law, mu, before_x, before_y, free_x, free_y):  # type: ignore[no-untyped-def]
    """A corner's friction coefficient in this step, of its slips [m/s] at the start and without contact forces."""
    if law.static_rel != 1.0:
        s = (before_x * before_x + before_y * before_y) / (law.slip_speed * law.slip_speed)
        mu *= 1.0 + (law.static_rel - 1.0) * math.exp(-s)
    if law.y_rel != 1.0:
        s = free_x * free_x + free_y * free_y
        if s > 0.0:
            mu *= math.sqrt(s / (free_x * free_x + free_y * free_y / (law.y_rel * law.y_rel)))
    return mu
