"""When an object may touch the ground, from its poses alone."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from tossid.objects import ObjectModel, corner_heights

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]
Touch = Callable[[Array, Array], Bools]
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


def may_touch(model: ObjectModel, t: Array, q: Array, begins: NDArray[np.int64] | None = None) -> Bools:
    """Whether the object may touch the ground at some time between a frame and the next, (n - 1,).

    Every corner's height is extrapolated linearly from the two frames before the interval and from the two after it, so
    that an impact between two frames that are both clear of the ground is found.

    Args:
        model: The object.
        t: Times [s], (n,).
        q: Configurations, (n, nq).
        begins: (B,) numbers of the first frames of motions that follow one another, if there are several. From the last
            frame of one to the first of the next nothing touches.
    """
    z, inside = corner_heights(model, q), np.ones(len(t) - 1, dtype=bool)
    if begins is not None:
        inside[begins[1:] - 1] = False
    h = np.where(inside, np.diff(t), 1.0)[:, None]  # times of two motions may be the same, and nothing is read between
    rise = np.diff(z, axis=0)
    low = np.minimum(z[:-1], z[1:])
    # a neighbouring interval tells how a corner moves, if it belongs to the same motion
    forward = z[1:-1] + rise[:-1] / h[:-1] * h[1:]
    low[1:] = np.where(inside[:-1, None], np.minimum(low[1:], forward), low[1:])
    backward = z[1:-1] - rise[1:] / h[1:] * h[:-1]
    low[:-1] = np.where(inside[1:, None], np.minimum(low[:-1], backward), low[:-1])
    return inside & (low.min(axis=1) < CLEARANCE_REL * model.width)


def runs(flags: Bools) -> list[tuple[int, int]]:
    """First and last index of each run of true flags, in order.

    Args:
        flags: (n,).
    """
    edges = np.flatnonzero(np.diff(np.concatenate([[False], flags, [False]]).astype(np.int8)))
    return list(zip(edges[::2].tolist(), (edges[1::2] - 1).tolist(), strict=True))
