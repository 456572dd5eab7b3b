"""The simulator's parameters as arrays that the kernels read."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tossid.errors import ObjectError
from tossid.objects import GRAVITY, JointLaw, ObjectModel
from tossid.physics.contact.rounds import Points, Shape, shape_of
from tossid.physics.registered_forces import NoForce, RegisteredForce
from tossid.settings.limits import VALUES

Array = NDArray[np.float64]


class LearnedAcceleration(NamedTuple):
    """A learned acceleration a_res(q, v) = W f + W2 tanh(W1 tanh(W0 f + b0) + b1).

    f are the first features of `free.features`. Those of the body are in the base's
    frame, where the world's symmetries (translation, turning about the vertical) are
    exact; the first nv outputs are an acceleration in the same frame. Velocity enters
    f as |v| R^T v, so that a linear drag matrix is quadratic drag. With the features of
    the world, too, there may be three more outputs: an acceleration of the base's origin
    along the world's axes. The force is k_res = M a_res. Empty arrays (zero rows of
    `linear`) mean none.

    Attributes:
        linear: (n_out, n_f) W; n_out is nv or nv + 3.
        W0: (h, n_f).
        b0: (h,).
        W1: (h, h).
        b1: (h,).
        W2: (n_out, h).
    """

    linear: Array
    W0: Array
    b0: Array
    W1: Array
    b1: Array
    W2: Array


class System(NamedTuple):
    """A kinematic tree over the ground plane z = 0, in SI units.

    Attributes:
        parent: (n_b,) of each body.
        joint_type: (n_b,) `JointType`.
        joint_pos: (n_b, 3) anchor of each joint, in its body's axes [m].
        joint_axis: (n_b, 3) unit axis of each joint, in its body's axes.
        body_pos: (n_b, 3) origin of each body, in its parent's axes [m].
        body_quat: (n_b, 4) orientation of each body in its parent's axes at joint position 0, wxyz.
        mass: (n_b,) [kg].
        com: (n_b, 3) centre of mass, in the body's axes [m].
        inertia: (n_b, 3, 3) about the centre of mass, in the body's axes [kg m²].
        corner_body: (n_c,) body of each corner.
        corner_pos: (n_c, 3) in its body's axes [m].
        mu: (n_c,) friction coefficient of each corner.
        restitution: Newton's coefficient.
        gravity: (3,) acceleration of the given continuous dynamics k_hat [m/s², world].
        k_res: a learned acceleration.
        compliance: how far a corner sinks for each newton on it, 1 / stiffness [m/N]; 0 for rigid contact.
        relaxation: damping over stiffness of a corner [s]: what sank comes out as exp(-t / relaxation).
        cohesion: c of |f_t| <= mu f_n + c [N]; the bound stays below 2 mu f_n. The law is in `stepping`.
        forces: (17,) the fields of `forces.Forces` in their order, (0,) for none.
        law: (11,) the fields of `forces.Law` in their order, (0,) for a constant friction.
        joints: what acts in the joints; empty arrays for nothing.
        registered: the user's own force (`registered_forces`).
        shape: what stands at the corners (`rounds`).
    """

    parent: NDArray[np.int64]
    joint_type: NDArray[np.int64]
    joint_pos: Array
    joint_axis: Array
    body_pos: Array
    body_quat: Array
    mass: Array
    com: Array
    inertia: Array
    corner_body: NDArray[np.int64]
    corner_pos: Array
    mu: Array
    restitution: float
    gravity: Array
    k_res: LearnedAcceleration
    compliance: float = 0.0
    relaxation: float = 0.0
    cohesion: float = 0.0
    forces: Array = np.zeros(0)
    law: Array = np.zeros(0)
    joints: JointLaw = JointLaw(*np.zeros((5, 0)))
    registered: RegisteredForce = NoForce()
    shape: Shape = Points()

    @property
    def nv(self) -> int:
        """Length of a velocity."""
        return 5 + len(self.parent)

    @property
    def nq(self) -> int:
        """Length of a configuration."""
        return 6 + len(self.parent)

    @property
    def n_corners(self) -> int:
        """Number of corners."""
        return len(self.corner_body)


N_WORLD = 13
"""Features of the world: the world's x (3) and y (3) in the base's axes, one (1), position (3), velocity (3)."""


def n_features(n_joints: int, *, world: bool = False) -> int:
    """Number of the learned acceleration's features.

    Those of the body: vertical (3), |v| v (3), spin (3); sin, cos, rate of each joint. Those of the world follow.

    Args:
        n_joints: of the object.
        world: with those of the world.
    """
    return 9 + 3 * n_joints + (N_WORLD if world else 0)


def no_learned_acceleration(n_joints: int) -> LearnedAcceleration:
    """A learned acceleration that is absent.

    Args:
        n_joints: of the object.
    """
    nv, nf = 6 + n_joints, n_features(n_joints)
    return LearnedAcceleration(
        np.zeros((0, nf)), np.zeros((0, nf)), np.zeros(0), np.zeros((0, 0)), np.zeros(0), np.zeros((nv, 0))
    )


def make_system(
    model: ObjectModel,
    *,
    gravity: float | ArrayLike = GRAVITY,
    friction: float | ArrayLike | None = None,
    k_res: LearnedAcceleration | None = None,
) -> System:
    """The nominal simulator of an object.

    Args:
        model: the object.
        gravity: downward acceleration [m/s²], or a world vector (3,).
        friction: one coefficient, or one a corner (n_c,); the object's own if None.
        k_res: a learned acceleration.

    Raises:
        ObjectError: gravity or friction is beyond `tossid.settings.limits.ValueLimits`, or the object has both
            restitution and a spring's compliance or relaxation.
    """
    if model.restitution > 0 and (model.compliance > 0 or model.relaxation > 0):
        raise ObjectError(
            f"object '{model.name}' has restitution {model.restitution:g} and compliance {model.compliance:g} m/N with "
            f"relaxation {model.relaxation:g} s: two models of the same bounce; one of them must be 0"
        )
    g = np.asarray(gravity, dtype=float)
    mu = np.asarray(model.friction if friction is None else friction, dtype=float)
    if not (np.abs(g) <= VALUES.gravity).all():  # NaN is none
        raise ObjectError(f"gravity is {g} m/s², expected at most {VALUES.gravity:g} m/s²")
    if not ((mu >= 0) & (mu <= VALUES.friction)).all():
        raise ObjectError(f"object '{model.name}': friction is {mu}, expected 0 to {VALUES.friction:g}")
    contiguous = np.ascontiguousarray
    return System(
        parent=contiguous(model.parent),
        joint_type=contiguous(model.joint_type),
        joint_pos=contiguous(model.joint_pos),
        joint_axis=contiguous(model.joint_axis),
        body_pos=contiguous(model.body_pos),
        body_quat=contiguous(model.body_quat),
        mass=contiguous(model.mass),
        com=contiguous(model.com),
        inertia=contiguous(model.inertia),
        corner_body=contiguous(model.corner_body),
        corner_pos=contiguous(model.corner_pos),
        mu=np.broadcast_to(mu, (model.n_corners,)).copy(),
        restitution=float(model.restitution),
        gravity=g.copy() if g.ndim else np.array([0.0, 0.0, -float(g)]),
        k_res=k_res or no_learned_acceleration(model.n_joints),
        compliance=float(model.compliance),
        relaxation=float(model.relaxation),
        cohesion=float(model.cohesion),
        joints=JointLaw(*map(contiguous, model.joints)),
        shape=shape_of(model.roundness),
    )
