"""A single body as the time-stepping kernel's model: a tree without joints, whose factor is constant.

About the centre of mass S is the inertia itself, so that nothing is factorised in a step.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tossid.kernels import implements, inlined_kernel
from tossid.objects import Roundness
from tossid.physics import moving
from tossid.physics.contact.rounds import bulge, is_round, lowest_offset
from tossid.physics.forces import (
    SPIN,
    Forces,
    inverse_damped_inertia,
    power_factor,
    to_world,
    velocity_change,
)
from tossid.physics.registered_forces import RegisteredForce, acts, wrench_of

if TYPE_CHECKING:
    from tossid.physics.system import System

Array = NDArray[np.float64]


class Body(NamedTuple):
    """One rigid body.

    Attributes:
        mass: [kg].
        com: (3,) centre of mass from the origin [m].
        inertia: (3, 3) about the centre of mass [kg m²].
        inverse: (3, 3) of the inertia.
        root: (3, 3) lower triangular W with W W^T the inverse of the inertia.
        L: (3, 3) lower Cholesky factor of the inertia, with the inverse of its diagonal on the diagonal.
        parent: (1,) unused, one body.
        corner_body: (n_c,) all zero.
        corner_pos: (n_c, 3) corners from the origin [m]; of rounded ones, their spheres' centres.
        gravity: (3,) [m/s², world].
        acts: whether `forces` or `registered` act.
        h_matters: whether accelerations depend on the step's length.
        pose_matters: whether the origin's accelerations depend on the pose.
        rests: whether a toss may end early, where the object has come to rest.
        forces: of the state.
        registered: the user's own force.
        rounds: what stands at the corners.
    """

    mass: float
    com: Array
    inertia: Array
    inverse: Array
    root: Array
    L: Array
    parent: NDArray[np.int64]
    corner_body: NDArray[np.int64]
    corner_pos: Array
    gravity: Array
    acts: bool
    h_matters: bool
    pose_matters: bool
    rests: bool
    forces: Forces
    registered: RegisteredForce
    rounds: Roundness

    def make_work(self) -> BodyWork:
        """Scratch of the time-stepping kernel for this body."""
        return BodyWork(self.L, self.inverse.copy(), np.zeros(1), np.zeros(3))


class BodyWork(NamedTuple):
    """Scratch of a body.

    Attributes:
        L: (3, 3) the body's.
        turn: (3, 3) inverse of the inertia, with what spin's drag adds to it in a step of length turn_h.
        turn_h: (1,) [s].
        row: (3,) direction of a spin.
    """

    L: Array
    turn: Array
    turn_h: Array
    row: Array


def make_body(system: System) -> Body | None:
    """The body of a system, or None for a tree and for a mass matrix that is not positive.

    Args:
        system: the simulator's parameters.
    """
    if system.nv != 6:
        return None
    mass, inertia = float(system.mass[0]), np.array(system.inertia[0])
    try:
        L = np.linalg.cholesky(inertia)
        inverse = np.linalg.inv(inertia)
        root = np.linalg.cholesky(0.5 * (inverse + inverse.T))
    except np.linalg.LinAlgError:
        return None
    if not (mass > 0.0 and np.isfinite(root).all()):
        return None
    np.fill_diagonal(L, 1.0 / np.diag(L))
    forces = Forces(*map(float, system.forces))
    return Body(
        mass=mass,
        com=np.array(system.com[0]),
        inertia=inertia,
        inverse=inverse,
        root=np.ascontiguousarray(root),
        L=np.ascontiguousarray(L),
        parent=np.array(system.parent),
        corner_body=np.array(system.corner_body),
        corner_pos=np.ascontiguousarray(rounded_corner_centres(system.corner_pos, system.law.rounding)),
        gravity=np.array(system.gravity),
        acts=forces.acts or acts(system.registered),
        h_matters=forces.acts,
        pose_matters=bool(forces.acts or acts(system.registered) or system.com[0].any()),
        rests=True,
        forces=forces,
        registered=system.registered,
        rounds=system.rounds,
    )


def rounded_corner_centres(corner_pos: Array, radius: float) -> Array:
    """Centres (n_c, 3) [m] of spheres in the corners of a box along the axes, which touch its faces.

    Args:
        corner_pos: (n_c, 3) the box's corners [m].
        radius: of the spheres [m].
    """
    middle = 0.5 * (corner_pos.min(axis=0) + corner_pos.max(axis=0))
    out: Array = corner_pos - radius * np.sign(corner_pos - middle)
    return out


@implements(moving.n_rates, Body)
def _n_rates(model):  # type: ignore[no-untyped-def]
    return 3


@implements(moving.inverse_mass, Body)
def _inverse_mass(model, work):  # type: ignore[no-untyped-def]
    return 1.0 / model.mass


@implements(moving.kinematics, Body)
def _kinematics(model, work, s):  # type: ignore[no-untyped-def]
    return


@inlined_kernel
def _com_position(model, s):  # type: ignore[no-untyped-def]
    """Position of the centre of mass at the step's start [m], world axes."""
    q, R, c = s.q, s.R, model.com
    return (
        q[0] + R[0, 0] * c[0] + R[0, 1] * c[1] + R[0, 2] * c[2],
        q[1] + R[1, 0] * c[0] + R[1, 1] * c[1] + R[1, 2] * c[2],
        q[2] + R[2, 0] * c[0] + R[2, 1] * c[1] + R[2, 2] * c[2],
    )


@implements(moving.accelerate, Body)
def _accelerate(model, work, s, h):  # type: ignore[no-untyped-def]
    # Euler's equation about the centre of mass: I dw/dt = (I w) x w + torque
    I, turn, c = model.inertia, work.turn, model.com
    w0, w1, w2 = s.xi_start[0], s.xi_start[1], s.xi_start[2]
    l0 = I[0, 0] * w0 + I[0, 1] * w1 + I[0, 2] * w2
    l1 = I[1, 0] * w0 + I[1, 1] * w1 + I[1, 2] * w2
    l2 = I[2, 0] * w0 + I[2, 1] * w1 + I[2, 2] * w2
    t0, t1, t2 = w2 * l1 - w1 * l2, w0 * l2 - w2 * l0, w1 * l0 - w0 * l1
    if model.acts:  # spin's drag, implicit in the mean spin: (I + h/2 c) dw/dt = I w x w - c w
        drag = model.forces.spin * power_factor(model.forces, SPIN, w0, w1, w2)
        t0, t1, t2 = t0 - drag * w0, t1 - drag * w1, t2 - drag * w2
        if work.turn_h[0] != h or model.forces.powered == SPIN:
            work.turn_h[0] = h
            inverse_damped_inertia(I, 0.5 * h * drag, work.turn)
        R = s.R  # (s.u_start is not there yet)
        o0, o1, o2 = to_world(R, w1 * c[2] - w2 * c[1], w2 * c[0] - w0 * c[2], w0 * c[1] - w1 * c[0])
        velocity = s.v[0] + o0, s.v[1] + o1, s.v[2] + o2
        _, (n0, n1, n2) = wrench_of(model.registered, _com_position(model, s), velocity, to_world(R, w0, w1, w2))
        t0 += R[0, 0] * n0 + R[1, 0] * n1 + R[2, 0] * n2
        t1 += R[0, 1] * n0 + R[1, 1] * n1 + R[2, 1] * n2
        t2 += R[0, 2] * n0 + R[1, 2] * n1 + R[2, 2] * n2
    g0 = turn[0, 0] * t0 + turn[0, 1] * t1 + turn[0, 2] * t2
    g1 = turn[1, 0] * t0 + turn[1, 1] * t1 + turn[1, 2] * t2
    g2 = turn[2, 0] * t0 + turn[2, 1] * t1 + turn[2, 2] * t2
    s.rate[0], s.rate[1], s.rate[2] = g0, g1, g2
    # of the origin: dw/dt x c + w x (w x c), with the sign of `State.a`
    c0, c1, c2 = c[0], c[1], c[2]
    s0, s1, s2 = w1 * c2 - w2 * c1, w2 * c0 - w0 * c2, w0 * c1 - w1 * c0
    s.a[0] = g1 * c2 - g2 * c1 + w1 * s2 - w2 * s1
    s.a[1] = g2 * c0 - g0 * c2 + w2 * s0 - w0 * s2
    s.a[2] = g0 * c1 - g1 * c0 + w0 * s1 - w1 * s0
    return True


@implements(moving.act_on_free, Body)
def _act_on_free(model, work, s, h):  # type: ignore[no-untyped-def]
    w, y = s.xi_start, s.xi
    m0, m1, m2 = velocity_change(
        model.forces, model.registered, model.gravity, 1.0 / model.mass, h, s.R, _com_position(model, s),
        (s.u_start[1], s.u_start[2], s.u_start[0]), (w[0], w[1], w[2]), (y[0], y[1], y[2]),
    )  # fmt: skip
    s.v_next[0], s.v_next[1], s.v_next[2] = s.v_next[0] + m0, s.v_next[1] + m1, s.v_next[2] + m2


@implements(moving.common_velocity, Body)
def _common_velocity(model, work, xi, first):  # type: ignore[no-untyped-def]
    w0, w1, w2 = xi[first], xi[first + 1], xi[first + 2]
    c0, c1, c2 = model.com[0], model.com[1], model.com[2]
    return w1 * c2 - w2 * c1, w2 * c0 - w0 * c2, w0 * c1 - w1 * c0


@implements(moving.corner_place, Body)
def _corner_place(model, work, s, c):  # type: ignore[no-untyped-def]
    pos = model.corner_pos
    if is_round(model.rounds):
        o0, o1, o2 = lowest_offset(model.rounds, c, s.R[2, 0], s.R[2, 1], s.R[2, 2])
        return pos[c, 0] + o0, pos[c, 1] + o1, pos[c, 2] + o2
    return pos[c, 0], pos[c, 1], pos[c, 2]


@implements(moving.contact_row, Body)
def _contact_row(model, work, s, corners, c, k):  # type: ignore[no-untyped-def]
    i = k - 1 if k else 2
    a0, a1, a2 = s.R[i, 0], s.R[i, 1], s.R[i, 2]
    d0, d1 = corners.place[c, 0] - model.com[0], corners.place[c, 1] - model.com[1]
    d2 = corners.place[c, 2] - model.com[2]
    corners.tau[c, k, 0] = d1 * a2 - d2 * a1
    corners.tau[c, k, 1] = d2 * a0 - d0 * a2
    corners.tau[c, k, 2] = d0 * a1 - d1 * a0


@implements(moving.whiten, Body)
def _whiten(model, work, corners, c, k, column):  # type: ignore[no-untyped-def]
    W, G, tau = model.root, corners.G, corners.tau
    t0, t1, t2 = tau[c, k, 0], tau[c, k, 1], tau[c, k, 2]
    G[0, column] = W[0, 0] * t0 + W[1, 0] * t1 + W[2, 0] * t2
    G[1, column] = W[1, 1] * t1 + W[2, 1] * t2
    G[2, column] = W[2, 2] * t2


@implements(moving.add_impulse, Body)
def _add_impulse(model, work, g, xi, out):  # type: ignore[no-untyped-def]
    W, g0, g1, g2 = model.root, g[0], g[1], g[2]
    out[0] = xi[0] + W[0, 0] * g0
    out[1] = xi[1] + W[1, 0] * g0 + W[1, 1] * g1
    out[2] = xi[2] + W[2, 0] * g0 + W[2, 1] * g1 + W[2, 2] * g2


@implements(moving.spin_row, Body)
def _spin_row(model, work, body, a0, a1, a2, row):  # type: ignore[no-untyped-def]
    row[0], row[1], row[2] = a0, a1, a2


@implements(moving.turning, Body)
def _turning(model, work, s, corners, c, k):  # type: ignore[no-untyped-def]
    # e_k . R w x (w x r)
    w, r, R, i = s.xi_start, model.corner_pos, s.R, k - 1 if k else 2
    along = w[0] * r[c, 0] + w[1] * r[c, 1] + w[2] * r[c, 2]
    squared, up = w[0] * w[0] + w[1] * w[1] + w[2] * w[2], R[i, 0] * w[0] + R[i, 1] * w[1] + R[i, 2] * w[2]
    turn = along * up - squared * (R[i, 0] * r[c, 0] + R[i, 1] * r[c, 1] + R[i, 2] * r[c, 2])
    if is_round(model.rounds) and k == 0:
        turn -= bulge(model.rounds, c, R[2, 0], R[2, 1], R[2, 2], w[0], w[1], w[2])
    return turn
