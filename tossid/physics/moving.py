"""What the time-stepping kernel asks of an object in motion: one name each, an implementation for a body and a tree.

In the base's axes about the common centre of mass, with u the velocity of that point and xi = (spin of the base, joint
rates) of length n_x, the mass matrix is diag(m 1, S), S = L L^T (see `articulated`). A contact direction a (world) at
the place r (base's axes, from the base's origin) has the row (a, tau):

    a . velocity = a . u + tau . xi,      J_i M^-1 J_j^T = a_i . a_j / m + G_i . G_j,      G = W^T tau,  S^-1 = W W^T

`model` is the object (`Body` or `Links`), `work` its scratch of `model.make_work()`, `s` the `State` of the step.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tossid.kernels import by_type, fused_kernel
from tossid.physics.network import N_WORLD

Array = NDArray[np.float64]


class State(NamedTuple):
    """A toss within a step: where it is, how it moves, and how it would move on.

    Attributes:
        q: (nq,) configuration at the step's start; v (nv,) velocity.
        v: (nv,) velocity at the step's start.
        q_next: (nq,) configuration at its end.
        v_next: (nv,) velocity at its end, or what it would be without contact.
        R: (3, 3) rotation of the base, at the start.
        u_start: (3,) velocity of the common centre of mass at the start, along the world's z, x, y [m/s].
        xi_start: (n_x,) spin of the base [rad/s] and joint rates, at the start.
        u: (3,) as u_start, at the step's end.
        xi: (n_x,) as xi_start, at the step's end.
        a: (3,) minus the acceleration of the base's origin, less gravity's, base's axes [m/s²].
        rate: (n_x,) d xi / dt.
        taken: (n_x,) what contact takes from xi in a strike, beside its impulses.
        feature: (n_f,) input of the learned acceleration.
        hidden: (2, h) its layers.
        learned: (nv + 3,) its output.
    """

    q: Array
    v: Array
    q_next: Array
    v_next: Array
    R: Array
    u_start: Array
    xi_start: Array
    u: Array
    xi: Array
    a: Array
    rate: Array
    taken: Array
    feature: Array
    hidden: Array
    learned: Array


@fused_kernel
def make_state(nq, nv, n_hidden):  # type: ignore[no-untyped-def]
    """The state of a toss, all zero."""
    nx = nv - 3
    return State(
        np.zeros(nq), np.zeros(nv), np.zeros(nq), np.zeros(nv), np.zeros((3, 3)), np.zeros(3), np.zeros(nx),
        np.zeros(3), np.zeros(nx), np.zeros(3), np.zeros(nx), np.zeros(nx),
        np.zeros(9 + 3 * (nv - 6) + N_WORLD), np.zeros((2, n_hidden)), np.zeros(nv + 3),
    )  # fmt: skip


@by_type
def n_rates(model):  # type: ignore[no-untyped-def]
    """n_x, known when compiled if the model has no joints, so that loops over it are unrolled."""


@by_type
def inverse_mass(model, work):  # type: ignore[no-untyped-def]
    """1 / m [1/kg]."""


@by_type
def kinematics(model, work, s):  # type: ignore[no-untyped-def]
    """The bodies' poses and spins at s.q, s.v; s.R is already there."""


@by_type
def accelerate(model, work, s, h):  # type: ignore[no-untyped-def]
    """Free accelerations s.a and s.rate over a step of length h, and the factor work.L. Whether M is positive."""


@by_type
def act_on_free(model, work, s, h):  # type: ignore[no-untyped-def]
    """What changes the free velocities s.v_next[:3] and s.xi of a step of length h beside accelerations."""


@by_type
def common_velocity(model, work, xi, first):  # type: ignore[no-untyped-def]
    """Velocity of the common centre of mass from the base's origin's, base's axes, for the rates from xi[first]."""


@by_type
def corner_place(model, work, s, c):  # type: ignore[no-untyped-def]
    """Place of corner c from the base's origin, base's axes; of a round one, its lowest point's."""


@by_type
def contact_row(model, work, s, corners, c, k):  # type: ignore[no-untyped-def]
    """corners.tau[c, k] (n_x,) of corner c along world direction k of (z, x, y). After `accelerate`."""


@by_type
def whiten(model, work, corners, c, k, column):  # type: ignore[no-untyped-def]
    """corners.G[:, column] = W^T tau[c, k], with S^-1 = W W^T."""


@by_type
def add_impulse(model, work, g, xi, out):  # type: ignore[no-untyped-def]
    """out = xi + W g: the rates after the impulses' sum g = sum G lam. Overwrites g."""


@by_type
def spin_row(model, work, body, a0, a1, a2, row):  # type: ignore[no-untyped-def]
    """row (n_x,) with row . xi the spin of a body about the direction a (base's axes)."""


@by_type
def turning(model, work, s, corners, c, k):  # type: ignore[no-untyped-def]
    """Acceleration of corner c along direction k at constant velocities [m/s²]: dJ_k/dt v. After `accelerate`.

    Of a round corner, the vertical one is that of its lowest point, which is not always the same one.
    """
