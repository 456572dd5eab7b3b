"""When an object may touch the ground, from its poses alone."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tossid.objects import ObjectModel, corner_positions

Array = NDArray[np.float64]

CLEARANCE_REL = 0.05
"""Of the object's width: how far a stated corner may be from the true one, and the ground from z = 0."""


def lowest_corner(model: ObjectModel, q: Array) -> Array:
    """Height [m] of the lowest corner of the stated geometry. (*b, nq) -> (*b,)."""
    return corner_positions(model, q)[..., 2].min(axis=-1)


def may_touch(model: ObjectModel, t: Array, q: Array) -> NDArray[np.bool_]:
    """Whether the object may touch the ground at some time between a frame and the next.

    Every corner's height is extended in a straight line from the two frames
    before the interval and back from the two after it: an impact between two
    frames that are both clear of the ground is not missed.

    Args:
        t: (n,). q: (n, nq).

    Returns:
        (n - 1,) bool.
    """
    height = corner_positions(model, q)[..., 2]
    h = np.diff(t)
    low = np.minimum(height[:-1], height[1:])
    if len(t) > 2:
        rate = np.diff(height, axis=0) / h[:, None]
        low[1:] = np.minimum(low[1:], height[1:-1] + rate[:-1] * h[1:, None])
        low[:-1] = np.minimum(low[:-1], height[1:-1] - rate[1:] * h[:-1, None])
    return low.min(axis=1) < CLEARANCE_REL * model.width
