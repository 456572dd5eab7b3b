"""The simulator's parameters as arrays that the kernels read."""

from __future__ import annotations

from functools import partial
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tossid.errors import ObjectError
from tossid.objects import GRAVITY, JointLaw, ObjectModel, Roundness
from tossid.physics.contact.law import Law
from tossid.physics.contact.rounds import POINTS
from tossid.physics.forces import Forces
from tossid.physics.network import LearnedAcceleration, no_learned_acceleration
from tossid.physics.registered_forces import NoForce, RegisteredForce
from tossid.settings.limits import VALUES

Array = NDArray[np.float64]


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
        forces: of the state, beside gravity.
        law: contact beyond a constant friction.
        joints: what acts in the joints; empty arrays for nothing.
        registered: the user's own force (`registered_forces`).
        rounds: what stands at the corners.
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
    forces: Forces = Forces()
    law: Law = Law()
    joints: JointLaw = JointLaw(*np.zeros((5, 0)))
    registered: RegisteredForce = NoForce()
    rounds: Roundness = POINTS

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
    return System(
        parent=np.array(model.parent),
        joint_type=np.array(model.joint_type),
        joint_pos=np.array(model.joint_pos),
        joint_axis=np.array(model.joint_axis),
        body_pos=np.array(model.body_pos),
        body_quat=np.array(model.body_quat),
        mass=np.array(model.mass),
        com=np.array(model.com),
        inertia=np.array(model.inertia),
        corner_body=np.array(model.corner_body),
        corner_pos=np.array(model.corner_pos),
        mu=np.broadcast_to(mu, (model.n_corners,)).copy(),
        restitution=float(model.restitution),
        gravity=g.copy() if g.ndim else np.array([0.0, 0.0, -float(g)]),
        k_res=k_res or no_learned_acceleration(model.n_joints),
        compliance=float(model.compliance),
        relaxation=float(model.relaxation),
        cohesion=float(model.cohesion),
        joints=JointLaw(*map(np.array, model.joints)),
        rounds=Roundness(*map(partial(np.array, order="C"), model.roundness or POINTS)),
    )
