"""Releases that are not free: first frames in which something else than flight moves the object.

A hand or a gripper lets go a little later than a recording begins, or a tracker's filter starts there. In one toss this
is lost in noise, which second differences of positions amplify. Over all tosses it shows: a frame's acceleration is
compared with that of the frames soon after it, which drag cannot change much.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.stats import wilcoxon

from tossid.motion import frames_in_flight
from tossid.objects import GRAVITY, ObjectModel
from tossid.types import Toss

_SOON, _AFTER = 3, 4
"""Frames after which second differences share no pose, and how many of them are averaged."""
_LEAST_CHANGE = 0.3
"""Median acceleration over that soon after, from which a first frame is not free [gravity]."""
_LEVEL = 1e-3
"""At which it must differ (signed ranks over tosses)."""
_FEWEST_TOSSES, _MOST_FRAMES = 6, 20
"""Tosses that must have the frame in flight, and frames that are left out."""


def bound_frames(tosses: Sequence[Toss], model: ObjectModel) -> int:
    """How many frames at the beginning of all tosses are not in free flight.

    Args:
        tosses: Of one object.
        model: The object, which says where flight ends.
    """
    changes = []
    for toss, n in zip(tosses, frames_in_flight(tosses, model), strict=True):
        # to the last but one frame: the landing may be in the last
        poses, t = toss.measured[0][: max(n - 1, 0), :3], toss.t[: max(n - 1, 0)]
        velocities = np.diff(poses, axis=0) / np.diff(t)[:, None]
        accelerations = np.diff(velocities, axis=0) / (0.5 * (t[2:] - t[:-2]))[:, None]
        count = len(accelerations) - _SOON - _AFTER + 1
        changes.append(
            [accelerations[k] - accelerations[k + _SOON : k + _SOON + _AFTER].mean(axis=0) for k in range(count)]
        )
    for k in range(_MOST_FRAMES):
        there = np.array([each[k] for each in changes if len(each) > k])
        if len(there) < _FEWEST_TOSSES or not _is_other(there):
            return k
    return _MOST_FRAMES


def _is_other(changes: np.ndarray) -> bool:
    """Whether changes of acceleration (n, 3) are clearly not zero, in any direction; ranks, as a few have an impact."""
    large = np.abs(np.median(changes, axis=0)) > _LEAST_CHANGE * GRAVITY
    moving = np.ptp(changes, axis=0) > 0
    tested = np.flatnonzero(large & moving)
    return any(float(wilcoxon(changes[:, axis]).pvalue) < _LEVEL for axis in tested)
