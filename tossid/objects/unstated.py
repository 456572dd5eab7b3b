"""The object of a recording of which nothing is stated: one rigid body, or two on a hinge, without a shape."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tossid.errors import InputError
from tossid.objects.model import JointType, ObjectModel

UNKNOWN = "unknown"
"""What such an object, and its first body, is called."""
LINK = "link_2"
"""What its second body is called."""


class Hinge(NamedTuple):
    """A hinge between two links.

    Attributes:
        body_pos: (3,) origin of link 2's frame in link 1's at angle zero [m].
        body_quat: (4,) orientation of link 2's frame in link 1's at angle zero.
        pos: (3,) a point of the axis in link 2's frame [m].
        axis: (3,) the axis in link 2's frame, unit.
    """

    body_pos: NDArray[np.float64]
    body_quat: NDArray[np.float64]
    pos: NDArray[np.float64]
    axis: NDArray[np.float64]


def unstated_object(
    *, com: ArrayLike = (0.0, 0.0, 0.0), gyration: float = 0.05, hinge: Hinge | None = None
) -> ObjectModel:
    """One rigid body, or two on a hinge, without corners; `ObjectModel.is_stated` is false.

    Frames are those that the tracker gave. Its mass of 1 kg, half of it in each link, and its size stand for nothing.

    Args:
        com: Centre of mass of each body, where motion has shown it [m].
        gyration: Radius that compares spins with speeds [m].
        hinge: Of two links.
    """
    n = 1 if hinge is None else 2
    zero, unit = np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0])
    pos, quat, joint_pos, axis = (zero, unit, zero, zero) if hinge is None else hinge
    return ObjectModel(
        name=UNKNOWN,
        body_names=(UNKNOWN, LINK)[:n],
        parent=np.array([-1, 0])[:n],
        joint_type=np.array([int(JointType.FREE), int(JointType.HINGE)])[:n],
        joint_pos=np.array([zero, joint_pos])[:n],
        joint_axis=np.array([zero, axis])[:n],
        body_pos=np.array([zero, pos])[:n],
        body_quat=np.array([unit, quat])[:n],
        mass=np.full(n, 1 / n),
        com=np.broadcast_to(np.asarray(com, dtype=float), (n, 3)).copy(),
        inertia=np.tile(gyration**2 / n * np.eye(3), (n, 1, 1)),
        corner_body=np.zeros(0, dtype=np.int64),
        corner_pos=np.zeros((0, 3)),
        friction=0.0,
        restitution=0.0,
        width=2 * gyration,
        tags=(),
        mjcf="",
    )


def hinge_of(model: ObjectModel) -> Hinge | None:
    """The hinge between an object's two links; None of one rigid body.

    Raises:
        InputError: It has other joints.
    """
    if not model.n_joints:
        return None
    if model.n_joints > 1 or model.joint_type[1] != JointType.HINGE:
        raise InputError(
            f"an unknown object is one rigid body or two links on a hinge; '{model.name}' has other joints"
        )
    return Hinge(model.body_pos[1], model.body_quat[1], model.joint_pos[1], model.joint_axis[1])


def need_stated(model: ObjectModel, what: str) -> None:
    """Refuse an object of which nothing is stated.

    Args:
        model: The object.
        what: What needs a stated one, as the subject of a sentence.

    Raises:
        InputError: The object has no shape.
    """
    if not model.is_stated:
        raise InputError(f"{what} needs a stated object, and the dataset was ingested with object=unknown")
