"""Which edges of a tag something lies against: what is beyond them is not the paper around the tag (Numba)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tossid.kernels import kernel
from tossid.vision.detection.corners import grey

Array = NDArray[np.float64]

LARGE_CELL, BRIGHTNESS = 3.0, 0.85
"""Width of a cell [px], and least brightness of paper beyond an edge, between the tag's black (0) and what lies beyond
its other edges (1)."""
SMALL_CELL, BRIGHTNESS_SMALL = 1.5, 0.5
"""The same for a small tag, where blur mixes in what lies farther out; in between, in proportion."""
HIDDEN_SHARE = 0.4
"""Share of an edge with less brightness beyond it that makes it a hidden one."""
PLACES = 12
"""Places along an edge that are looked at."""


@kernel
def hidden_edges(image: NDArray[np.uint8], corners: Array, cells: int) -> tuple[NDArray[np.bool_], float]:
    """The edges of a detected tag that may be a hand's and not its own.

    A hand that covers a tag's white margin and a bit of its border leaves a black square that is a little smaller,
    and still can be read. But beyond a tag's own edge is paper, as bright as beyond its other edges.

    Args:
        image: (height, width) grey levels.
        corners: (4, 2) of the tag [px].
        cells: Cells across the tag, its black border included.

    Returns:
        (4,) whether the edge from each corner to the next may be hidden; and the width of a cell [px].
    """
    outer, inner = np.empty((4, PLACES)), np.empty((4, PLACES))
    middle, cell, hidden = np.empty(4), np.zeros(4), np.zeros(4, dtype=np.bool_)
    for e in range(4):
        a, b, c, d = corners[e], corners[(e + 1) % 4], corners[(e + 2) % 4], corners[(e + 3) % 4]
        for k in range(PLACES):
            share = (k + 0.5) / PLACES
            x, y = a[0] + share * (b[0] - a[0]), a[1] + share * (b[1] - a[1])
            # from the opposite edge to this one, a cell at a time
            ux = (x - (d[0] + share * (c[0] - d[0]))) / cells
            uy = (y - (d[1] + share * (c[1] - d[1]))) / cells
            cell[e] += np.hypot(ux, uy) / PLACES
            outer[e, k] = grey(image, x + 0.6 * ux, y + 0.6 * uy)
            inner[e, k] = grey(image, x - 0.5 * ux, y - 0.5 * uy)
        middle[e] = np.median(outer[e])
    black = np.median(inner)
    white = np.sort(middle)[2]  # one edge may have a glare beyond it
    for e in range(4):
        share = min(max((cell[e] - SMALL_CELL) / (LARGE_CELL - SMALL_CELL), 0.0), 1.0)
        least = black + (BRIGHTNESS_SMALL + share * (BRIGHTNESS - BRIGHTNESS_SMALL)) * (white - black)
        hidden[e] = np.sum(outer[e] < least) > HIDDEN_SHARE * PLACES
    return hidden, cell.mean()
