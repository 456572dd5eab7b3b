"""Which edges of a tag something lies against: what is beyond them is not the paper around the tag (Numba)."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from tossid.vision.corners import grey

Array = NDArray[np.float64]

DIM, DIM_SMALL = 0.85, 0.5
"""Paper is at least so bright, between the tag's black and the brightness beyond its other edges, where a cell is
`LARGE` [px] across or more, and where it is `SMALL` and blur mixes in what lies farther out; between, in proportion."""
SMALL, LARGE = 1.5, 3.0
PART = 0.4
"""Share of an edge with less beyond it that makes it a hidden one."""
POINTS = 12
"""Places along an edge that are looked at."""


def hidden_edges(image: NDArray[np.uint8], corners: Array, *, cells: int = 8) -> tuple[NDArray[np.bool_], float]:
    """Edges of a found tag that may be a hand's and not its own.

    A hand that covers a tag's white margin and a bit of its border leaves a black square that is a little smaller,
    and still can be read. But beyond a tag's own edge is paper, as bright as beyond its other edges.

    Args:
        image: (height, width). corners: (4, 2) [px]. cells: across the tag, its black border included.

    Returns:
        hidden: (4,) of the edges from each corner to the next; the width of a cell [px].
    """
    hidden = np.zeros(4, dtype=np.bool_)
    width = _look(image, np.ascontiguousarray(corners, dtype=float), cells, hidden)
    return hidden, float(width)


@njit(cache=True, nogil=True)
def _look(image: NDArray[np.uint8], corners: Array, cells: int, hidden: NDArray[np.bool_]) -> float:
    outer, inner = np.empty((4, POINTS)), np.empty((4, POINTS))
    middle, cell = np.empty(4), np.zeros(4)
    for e in range(4):
        a, b, c, d = corners[e], corners[(e + 1) % 4], corners[(e + 2) % 4], corners[(e + 3) % 4]
        for k in range(POINTS):
            share = (k + 0.5) / POINTS
            x, y = a[0] + share * (b[0] - a[0]), a[1] + share * (b[1] - a[1])
            # from the opposite edge to this one, a cell at a time
            ux = (x - (d[0] + share * (c[0] - d[0]))) / cells
            uy = (y - (d[1] + share * (c[1] - d[1]))) / cells
            cell[e] += np.hypot(ux, uy) / POINTS
            outer[e, k] = grey(image, x + 0.6 * ux, y + 0.6 * uy)
            inner[e, k] = grey(image, x - 0.5 * ux, y - 0.5 * uy)
        middle[e] = np.median(outer[e])
    black = np.median(inner)
    white = np.sort(middle)[2]  # one edge may have a glare beyond it
    for e in range(4):
        share = min(max((cell[e] - SMALL) / (LARGE - SMALL), 0.0), 1.0)
        least = black + (DIM_SMALL + share * (DIM - DIM_SMALL)) * (white - black)
        hidden[e] = np.sum(outer[e] < least) > PART * POINTS
    return cell.mean()
