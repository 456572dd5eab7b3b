"""The object of a recording of which nothing is stated: one rigid body without a shape."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from tossid.errors import InputError
from tossid.objects.model import JointType, ObjectModel

UNKNOWN = "unknown"
"""What such an object is called."""


def unstated_object(*, com: ArrayLike = (0.0, 0.0, 0.0), gyration: float = 0.05) -> ObjectModel:
    """One rigid body without corners, in whatever frame the tracker gave it; `ObjectModel.is_stated` is false.

    Its mass of 1 kg and its size stand for nothing.

    Args:
        com: Centre of mass, where motion has shown it [m].
        gyration: Radius that compares spins with speeds [m].
    """
    return ObjectModel(
        name=UNKNOWN,
        body_names=(UNKNOWN,),
        parent=np.array([-1]),
        joint_type=np.array([int(JointType.FREE)]),
        joint_pos=np.zeros((1, 3)),
        joint_axis=np.zeros((1, 3)),
        body_pos=np.zeros((1, 3)),
        body_quat=np.array([[1.0, 0.0, 0.0, 0.0]]),
        mass=np.ones(1),
        com=np.array(com, dtype=float).reshape(1, 3),
        inertia=gyration**2 * np.eye(3)[None],
        corner_body=np.zeros(0, dtype=np.int64),
        corner_pos=np.zeros((0, 3)),
        friction=0.0,
        restitution=0.0,
        width=2 * gyration,
        tags=(),
        mjcf="",
    )


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
