"""Tosses whose heights were set one by one, so that each says where the ground is only under its last frame.

Some publishers shift each toss so that the lowest corner of its last frame is at z = 0. In a tilted world, the ground's
height differs from place to place, and the shifts have taken that out. A tilt then turns each toss about that corner.
Turned about the origin, tosses that end elsewhere would come to rest above or below the ground.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from tossid.motion.sessions.levelling import as_recorded
from tossid.motion.sessions.search import heights_were_shifted
from tossid.objects import ObjectModel, corner_heights, corner_positions
from tossid.types import RecordingOrder, Toss

Array = NDArray[np.float64]


def have_own_heights(tosses: Sequence[Toss], model: ObjectModel, order: RecordingOrder | None) -> bool:
    """Whether tosses were recorded or published with heights that were set one by one.

    Args:
        tosses: Of one dataset.
        model: The object.
        order: The dataset's order of recording, which knows what was undone; None where it was not looked at.
    """
    last = [as_recorded(toss, order).measured[0][-2:] for toss in tosses]
    return heights_were_shifted(np.array([corner_heights(model, q).min(axis=1) for q in last]))


def moved(toss: Toss, by: Array) -> Toss:
    """A toss at another place.

    Args:
        toss: The toss.
        by: x and y (2,) that are added to its positions [m].
    """
    step = np.zeros(toss.q.shape[1])
    step[:2] = by
    return replace(toss, q=toss.q + step, q_measured=None if toss.q_measured is None else toss.q_measured + step)


def last_corner(toss: Toss, model: ObjectModel) -> Array:
    """x and y (2,) of the lowest corner in a toss's last frame [m].

    Args:
        toss: The toss.
        model: The object.
    """
    corners = corner_positions(model, toss.measured[0][-1:])[0]
    lowest: Array = corners[np.argmin(corners[:, 2]), :2]
    return lowest


def ending_at_origin(tosses: Sequence[Toss], model: ObjectModel) -> tuple[Toss, ...]:
    """Tosses that are moved along the ground, each so that its last frame's lowest corner is at x = y = 0.

    Args:
        tosses: The tosses.
        model: The object.
    """
    return tuple(moved(toss, -last_corner(toss, model)) for toss in tosses)
