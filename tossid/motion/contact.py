"""When an object may touch the ground, from its poses alone."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from tossid.kernels import kernel
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


def may_touch(model: ObjectModel, t: Array, q: Array, begins: NDArray[np.int64] | None = None) -> NDArray[np.bool_]:
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
    edges = np.array([0, len(t)]) if begins is None else np.append(begins, len(t))
    low = np.full(len(t) - 1, np.inf)
    _lowest(np.ascontiguousarray(t), np.ascontiguousarray(corner_heights(model, q)), edges, low)
    return low < CLEARANCE_REL * model.width


@kernel(allocates=False)
def _lowest(t, height, edges, low):  # type: ignore[no-untyped-def]
    """Write the lowest height of any corner between a frame and the next of the same motion into `low` (n - 1,).

    Args:
        t: (n,) times.
        height: (n, n_c) of the corners.
        edges: (B + 1,) the motions' first frames, and n.
        low: (n - 1,).
    """
    for m in range(len(edges) - 1):
        first, last = edges[m], edges[m + 1] - 1
        for k in range(first, last):
            h = t[k + 1] - t[k]
            for c in range(height.shape[1]):
                begin, end = height[k, c], height[k + 1, c]
                lowest = min(begin, end)
                if k > first:
                    lowest = min(lowest, begin + (begin - height[k - 1, c]) / (t[k] - t[k - 1]) * h)
                if k + 1 < last:
                    lowest = min(lowest, end - (height[k + 2, c] - end) / (t[k + 2] - t[k + 1]) * h)
                low[k] = min(low[k], lowest)
