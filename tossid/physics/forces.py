"""Forces of the state on a single body.

Forces act at the centre of mass p, with velocity u and world spin omega, and are taken at the step's middle.
With O = magnus / m omega + turning e_z and k the drag per mass at the speed there,

    u' = u + h (g + a(p + h u / 2) + O x U - k U),     U = (u + u') / 2, in magnus and drag less the wind

is second order, conserves the energy of a spring over long times, and is stable for any drag: u' is solved for.
Spin drag is likewise implicit in the mean spin.
"""

from __future__ import annotations

import math
from enum import IntEnum
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tossid.kernels import inlined_kernel, lean_kernel
from tossid.physics.registered_forces import wrench_of

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
        idle = ("wind_x", "wind_y", "center_x", "center_y", "center_z", "powered", "power")
        return self != Forces()._replace(**{name: getattr(self, name) for name in idle})


def wrench(forces: Forces, mass: float, p: Array, u: Array, omega: Array) -> tuple[Array, Array]:
    """The forces of the state on a body in several states, in the same axes.

    Args:
        forces: The forces.
        mass: Of the body [kg].
        p: (*b, 3) places of its centre of mass [m].
        u: (*b, 3) velocities there [m/s].
        omega: (*b, 3) spins [rad/s].

    Returns:
        Force (*b, 3) [N] on the centre of mass, and torque (*b, 3) [N m] about it.
    """
    f, up = forces, np.array([0.0, 0.0, 1.0])
    air = u - np.array([f.wind_x, f.wind_y, 0.0])
    away = np.array([f.center_x, f.center_y, f.center_z]) - p

    def size(state: Array) -> Array:
        return np.asarray(np.linalg.norm(state, axis=-1, keepdims=True))

    def grown(which: PoweredForce, state: Array) -> Array | float:
        return np.maximum(size(state), LEAST_STATE) ** f.power if f.powered == which else 1.0

    force = (
        np.array([f.x, f.y, f.z])
        - (f.linear + f.quadratic * size(air)) * grown(PoweredForce.DRAG, air) * air
        + f.magnus * grown(PoweredForce.MAGNUS, omega) * np.cross(omega, air)
        + f.spring * grown(PoweredForce.SPRING, away) * away
        + f.vortex * grown(PoweredForce.VORTEX, p[..., :2]) * np.cross(up, p)
        + mass * f.turning * grown(PoweredForce.TURNING, u) * np.cross(up, u)
    )
    return force, -f.spin * grown(PoweredForce.SPIN, omega) * omega


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
