"""A tree of bodies as the time-stepping kernel's model.

Free motion comes from `articulated`, what acts beside gravity from `pulls`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tossid.kernels import implements, inlined_kernel
from tossid.objects import JointLaw, Roundness
from tossid.physics import articulated, moving
from tossid.physics.articulated import (
    ACCEL,
    ALPHA,
    FORCE,
    MASS,
    SPIN,
    WIDTH,
    Articulated,
    X,
    make_articulated,
    turning_acceleration,
)
from tossid.physics.body import rounded_corner_centres
from tossid.physics.cholesky import back_substitute
from tossid.physics.contact.rounds import bulge, is_round, lowest_offset
from tossid.physics.forces import Forces
from tossid.physics.pulls import add_forces, joint_torques, resist_joints
from tossid.physics.registered_forces import RegisteredForce, acts

if TYPE_CHECKING:
    from tossid.physics.system import System

Array = NDArray[np.float64]


class Links(NamedTuple):
    """A tree of bodies; shapes as in `System`.

    Attributes:
        tree: bodies and joints.
        parent: (n_b,) of `tree`.
        corner_body: (n_c,) body of each corner.
        corner_pos: (n_c, 3) corners in their bodies' axes [m]; of rounded ones, their spheres' centres.
        gravity: (3,) [m/s², world].
        total: mass of the whole [kg].
        acts: whether joints rub.
        h_matters: whether accelerations depend on the step's length.
        pose_matters: whether they depend on the pose; they do.
        rests: whether a toss may end early, where the object has come to rest.
        jointed: whether `joints` acts.
        joints: what acts in the joints.
        forced: whether `forces` acts.
        forces: of the state.
        registered: the user's own force.
        rounds: what stands at the corners.
    """

    tree: Articulated
    parent: NDArray[np.int64]
    corner_body: NDArray[np.int64]
    corner_pos: Array
    gravity: Array
    total: float
    acts: bool
    h_matters: bool
    pose_matters: bool
    rests: bool
    jointed: bool
    joints: JointLaw
    forced: bool
    forces: Forces
    registered: RegisteredForce
    rounds: Roundness

    def make_work(self) -> LinksWork:
        """Scratch of the time-stepping kernel for this tree."""
        nb, z = len(self.parent), np.zeros
        nx = 2 + nb
        return LinksWork(z((nb, WIDTH)), z((nb, 3, 3)), z((nx, nx)), z((nb, 3)), z(nb), z(nb), z(nb), z(nx), z(nx))


class LinksWork(NamedTuple):
    """Scratch of a tree.

    Attributes:
        P: (n_b, WIDTH) vectors of each body, see `articulated`.
        E: (n_b, 3, 3) rotation of each body's axes in the base's.
        L: (n_x, n_x) factor of S.
        U: (n_b, 3) velocities of the bodies' origins.
        torque: (n_b,) of the joints.
        slack: (n_b,) what joints add to S's diagonal.
        taken: (n_b,) impulses of the joints' friction.
        row: (n_x,) direction of a spin.
        y: (n_x,).
    """

    P: Array
    E: Array
    L: Array
    U: Array
    torque: Array
    slack: Array
    taken: Array
    row: Array
    y: Array


def make_links(system: System) -> Links:
    """The tree of a system.

    Args:
        system: the simulator's parameters.
    """
    forces, law = Forces(*map(float, system.forces)), system.law
    law_of_joints = system.joints
    given = len(law_of_joints.damping) > 0
    joints = JointLaw(*(np.array(part) if given else np.zeros(len(system.parent)) for part in law_of_joints))
    corner_pos = system.corner_pos.copy()
    for body in set(system.corner_body.tolist()):
        mine = system.corner_body == body
        corner_pos[mine] = rounded_corner_centres(system.corner_pos[mine], law.rounding)
    return Links(
        tree=make_articulated(system),
        parent=np.array(system.parent),
        corner_body=np.array(system.corner_body),
        corner_pos=corner_pos,
        gravity=np.array(system.gravity),
        total=float(system.mass.sum()),
        acts=bool(law_of_joints.acts and joints.friction.max() > 0.0),
        h_matters=bool(forces.acts or acts(system.registered) or law_of_joints.acts),
        pose_matters=True,
        rests=False,
        jointed=law_of_joints.acts,
        joints=joints,
        forced=forces.acts or acts(system.registered),
        forces=forces,
        registered=system.registered,
        rounds=system.rounds,
    )


@implements(moving.n_rates, Links)
def _n_rates(model):  # type: ignore[no-untyped-def]
    return 2 + model.parent.shape[0]


@implements(moving.inverse_mass, Links)
def _inverse_mass(model, work):  # type: ignore[no-untyped-def]
    return 1.0 / work.P[0, MASS]


@implements(moving.kinematics, Links)
def _kinematics(model, work, s):  # type: ignore[no-untyped-def]
    articulated.outward_pass(model.tree, s.q, s.v, work.P, work.E)


@implements(moving.accelerate, Links)
def _accelerate(model, work, s, h):  # type: ignore[no-untyped-def]
    tree, P = model.tree, work.P
    articulated.own_inertia_and_bias(tree, P, work.E)
    if model.forced:
        add_forces(model, work, s, h)
    articulated.inward_pass(tree.parent, P)
    if model.jointed:
        joint_torques(model.joints, h, s.q, s.v, work.torque, work.slack)
    good = articulated.factorise(tree.parent, tree.joint_type, work.torque, work.slack, P, work.L, s.rate)
    a0, a1, a2 = articulated.common_velocity(P, s.rate, 0)
    over_m = 1.0 / P[0, MASS]
    s.a[0], s.a[1], s.a[2] = a0 + over_m * P[0, FORCE], a1 + over_m * P[0, FORCE + 1], a2 + over_m * P[0, FORCE + 2]
    return good


@implements(moving.act_on_free, Links)
def _act_on_free(model, work, s, h):  # type: ignore[no-untyped-def]
    resist_joints(model.joints.friction, h, work.L, work.y, work.taken, s.xi)


@implements(moving.common_velocity, Links)
def _common_velocity(model, work, xi, first):  # type: ignore[no-untyped-def]
    return articulated.common_velocity(work.P, xi, first)


@implements(moving.corner_place, Links)
def _corner_place(model, work, s, c):  # type: ignore[no-untyped-def]
    b, pos, P = model.corner_body[c], model.corner_pos, work.P
    x0, x1, x2 = pos[c, 0], pos[c, 1], pos[c, 2]
    if is_round(model.rounds):
        o0, o1, o2 = lowest_offset(model.rounds, c, *_vertical(work.E, b, s.R))
        x0, x1, x2 = x0 + o0, x1 + o1, x2 + o2
    r0, r1, r2 = articulated.rotated(work.E, b, x0, x1, x2)
    return P[b, X] + r0, P[b, X + 1] + r1, P[b, X + 2] + r2


@inlined_kernel
def _vertical(E, b, R):  # type: ignore[no-untyped-def]
    """The world's vertical in the axes of body b."""
    return _in_body(E, b, R[2, 0], R[2, 1], R[2, 2])


@inlined_kernel
def _in_body(E, b, x0, x1, x2):  # type: ignore[no-untyped-def]
    """The vector E[b]^T x: from the base's axes to body b's."""
    return (
        E[b, 0, 0] * x0 + E[b, 1, 0] * x1 + E[b, 2, 0] * x2,
        E[b, 0, 1] * x0 + E[b, 1, 1] * x1 + E[b, 2, 1] * x2,
        E[b, 0, 2] * x0 + E[b, 1, 2] * x1 + E[b, 2, 2] * x2,
    )


@implements(moving.contact_row, Links)
def _contact_row(model, work, s, corners, c, k):  # type: ignore[no-untyped-def]
    articulated.contact_row(model.tree, work.P, model.corner_body[c], corners.place, s.R, corners.tau, c, k)


@implements(moving.whiten, Links)
def _whiten(model, work, corners, c, k, column):  # type: ignore[no-untyped-def]
    L, G = work.L, corners.G
    for x in range(L.shape[0]):  # W = L^-T: L G = tau
        t = corners.tau[c, k, x]
        for j in range(x):
            t -= L[x, j] * G[j, column]
        G[x, column] = t * L[x, x]


@implements(moving.add_impulse, Links)
def _add_impulse(model, work, g, xi, out):  # type: ignore[no-untyped-def]
    back_substitute(work.L, g, g.shape[0])
    for x in range(g.shape[0]):
        out[x] = xi[x] + g[x]


@implements(moving.spin_row, Links)
def _spin_row(model, work, body, a0, a1, a2, row):  # type: ignore[no-untyped-def]
    articulated.spin_row(model.tree, work.P, body, a0, a1, a2, row)


@implements(moving.turning, Links)
def _turning(model, work, s, corners, c, k):  # type: ignore[no-untyped-def]
    P, R, b, i, pos = work.P, s.R, model.corner_body[c], k - 1 if k else 2, model.corner_pos
    r0, r1, r2 = articulated.rotated(work.E, b, pos[c, 0], pos[c, 1], pos[c, 2])
    s0, s1, s2 = turning_acceleration(
        P[b, ALPHA], P[b, ALPHA + 1], P[b, ALPHA + 2], P[b, SPIN], P[b, SPIN + 1], P[b, SPIN + 2],
        r0, r1, r2,
    )  # fmt: skip
    turn = R[i, 0] * (P[b, ACCEL] + s0) + R[i, 1] * (P[b, ACCEL + 1] + s1) + R[i, 2] * (P[b, ACCEL + 2] + s2)
    if is_round(model.rounds) and k == 0:
        u0, u1, u2 = _vertical(work.E, b, R)
        w0, w1, w2 = _in_body(work.E, b, P[b, SPIN], P[b, SPIN + 1], P[b, SPIN + 2])
        turn -= bulge(model.rounds, c, u0, u1, u2, w0, w1, w2)
    return turn
