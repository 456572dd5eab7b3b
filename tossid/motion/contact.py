"""When an object may touch the ground, from its poses alone."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from tossid.objects import ObjectModel, corner_heights

Array = NDArray[np.float64]
Touch = Callable[[Array, Array], NDArray[np.bool_]]
"""Whether an object may touch the ground between frames (n - 1,), given times (n,) and configurations (n, nq)."""

CLEARANCE_REL = 0.05
"""How far a stated corner may be from the true one, and the ground from z = 0, in widths of the object."""


def lowest_corner(model: ObjectModel, q: Array) -> Array:
    """Height of the lowest corner of the stated geometry [m], (*b,).

    Args:
        model: The object.
        q: Configurations, (*b, nq).
    """
    return corner_heights(model, q).min(axis=-1)


def may_touch(model: ObjectModel, t: Array, q: Array) -> NDArray[np.bool_]:
    """Whether the object may touch the ground at some time between a frame and the next, (n - 1,).

    Every corner's height is extrapolated linearly from the two frames before the interval and from the two after it, so
    that an impact between two frames that are both clear of the ground is found.

    Args:
        model: The object.
        t: Times [s], (n,).
        q: Configurations, (n, nq).
    """
    height = corner_heights(model, q)
    h = np.diff(t)
    low = np.minimum(height[:-1], height[1:])
    if len(t) > 2:
        rate = np.diff(height, axis=0) / h[:, None]
        low[1:] = np.minimum(low[1:], height[1:-1] + rate[:-1] * h[1:, None])
        low[:-1] = np.minimum(low[:-1], height[1:-1] - rate[1:] * h[:-1, None])
    return low.min(axis=1) < CLEARANCE_REL * model.width
