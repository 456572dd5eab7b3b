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
    adhesion                of corners that carried load in the step before or are within `ADHESION_REACH`
"""

from __future__ import annotations

import math
from enum import IntEnum
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tossid.kernels import lean_kernel

Array = NDArray[np.float64]


class Growing(IntEnum):
    """The force that grows with a further power of its state: a value of `Forces.powered`."""

    NONE = 0
    DRAG = 1
    SPIN = 2
    MAGNUS = 3
    SPRING = 4
    VORTEX = 5
    TURNING = 6


NONE, DRAG, SPIN, MAGNUS, SPRING, VORTEX, TURNING = map(int, Growing)
"""The same, as kernels compare them."""
LEAST = 1e-6
"""Of a state, whose power would be infinite at 0."""
ADHESION_REACH = 5e-4
"""Height [m] up to which a corner is held by adhesion."""


class Forces(NamedTuple):
    """Forces and torques of the state, at the centre of mass, in the world. u, omega: its velocity and spin there.

    linear [N s/m], quadratic [N s²/m²]: drag -c w, -c |w| w of the velocity w = u - wind. spin [N m s]: torque
    -c omega. wind_x, wind_y [m/s]. magnus [N s²/m]: c omega x w. x, y, z [N]: a uniform force. spring [N/m]
    towards (center_x, center_y, center_z) [m]. vortex [N/m]: c e_z x p. turning [1/s]: m c e_z x u, as in a frame
    that turns at -c/2.
    power: one of them (`powered`) grows with this further power of what it depends on, in SI: drag with speed in
    the wind (DRAG), spin drag and Magnus's force with spin (SPIN, MAGNUS), the spring with its length (SPRING), the
    vortex with the distance from its axis (VORTEX), turning with speed (TURNING).
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

    Friction at slip speed s is mu (1 + (static_rel - 1) exp(-(s / slip_speed)²)), static_rel = 1 for none;
    y_rel: friction along the world's y over that along x, 1 / mu² = d_x² / mu_x² + d_y² / mu_y² for a slip along d.
    torsional, rolling [m]: torque per normal force against spin about the vertical and about the horizontal.
    adhesion [N]: pull of the ground on each touching corner.
    lifting [m]: height of a corner below which a step's contact problem is the convex relaxation of Coulomb's (Anitescu
    2006), as MuJoCo has it: what slips at s leaves the ground at mu s. 0: Coulomb's law throughout.
    rounding [m]: radius of the corners, spheres that touch the faces of a box with sharp ones (`inset`).
    added_mass [kg]: of each corner in contact that yields: its force is that of its spring and damper, less this mass
    times its acceleration (MuJoCo's 1 / R, by which contact holds most of a load at once).
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

    @property
    def acts(self) -> bool:
        """Whether contact differs from that of a constant friction; the slip speed alone does not."""
        return self != Law(slip_speed=self.slip_speed)


def forces_of(numbers: Array) -> Forces:
    """Forces from their numbers in order (17,), none of an empty array."""
    return Forces(*map(float, numbers))


def law_of(numbers: Array) -> Law:
    """The law from its numbers in order (9,), the nominal one of an empty array."""
    return Law(*map(float, numbers))


@lean_kernel
def damped(inertia, c, out):  # type: ignore[no-untyped-def]
    """out (3, 3) = (I + c 1)^-1, by cofactors."""
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
def grown(forces, which, x0, x1, x2):  # type: ignore[no-untyped-def]
    """By what a force is multiplied whose state is the vector x, if it is the one that grows with another power."""
    if forces.powered != which:
        return 1.0
    return max(math.sqrt(x0 * x0 + x1 * x1 + x2 * x2), LEAST) ** forces.power


@lean_kernel
def push(forces, gravity, over_m, h, R, place, velocity, spin, spin_after):  # type: ignore[no-untyped-def]
    """What the forces add to the velocity of the centre of mass over a step [m/s, world], beside gravity's h g.

    R (3, 3): orientation at the start. place, velocity: of the centre of mass at the start; spin (body's axes) at the
    start and, without the forces, at the end; tuples of three.
    """
    f = forces
    p0, p1, p2 = place
    u0, u1, u2 = velocity
    w0, w1, w2 = spin
    y0, y1, y2 = spin_after
    # at the middle of the step: place, then the acceleration that does not depend on velocity
    half = 0.5 * h
    p0, p1, p2 = p0 + half * u0, p1 + half * u1, p2 + half * u2
    d0, d1, d2 = f.center_x - p0, f.center_y - p1, f.center_z - p2
    spring = f.spring * grown(f, SPRING, d0, d1, d2)
    vortex = f.vortex * grown(f, VORTEX, p0, p1, 0.0)
    turning = f.turning * grown(f, TURNING, u0, u1, u2)
    a0 = gravity[0] + over_m * (f.x + spring * d0 - vortex * p1)
    a1 = gravity[1] + over_m * (f.y + spring * d1 + vortex * p0)
    a2 = gravity[2] + over_m * (f.z + spring * d2)
    # relative to the wind, in which turning adds a constant
    a0, a1 = a0 - turning * f.wind_y, a1 + turning * f.wind_x
    e0, e1, e2 = u0 - f.wind_x, u1 - f.wind_y, u2
    k = over_m * (f.linear + f.quadratic * math.sqrt(e0 * e0 + e1 * e1 + e2 * e2)) * grown(f, DRAG, e0, e1, e2)
    s = 1.0 / (1.0 + half * k)
    m0, m1, m2 = s * (e0 + half * a0), s * (e1 + half * a1), s * (e2 + half * a2)
    k = over_m * (f.linear + f.quadratic * math.sqrt(m0 * m0 + m1 * m1 + m2 * m2)) * grown(f, DRAG, m0, m1, m2)
    # the mean velocity U: (1 + h/2 k) U - h/2 O x U = e + h/2 a
    s0, s1, s2 = 0.5 * (w0 + y0), 0.5 * (w1 + y1), 0.5 * (w2 + y2)
    b = 1.0 / (1.0 + half * k)
    c = half * b * over_m * f.magnus * grown(f, MAGNUS, s0, s1, s2)
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
