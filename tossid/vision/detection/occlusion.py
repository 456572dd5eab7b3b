"""Which edges of a tag something lies against: what is beyond them is not the paper around the tag (Numba)."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tossid.kernels import kernel
from tossid.settings.ingestion import OcclusionSettings
from tossid.vision.detection.corners import grey

Array = NDArray[np.float64]

DEFAULT = OcclusionSettings()


class _Limits(NamedTuple):
    """`OcclusionSettings` for the kernel."""

    brightness: float
    brightness_small: float
    small_cell: float
    large_cell: float
    hidden_share: float
    points: int


def hidden_edges(
    image: NDArray[np.uint8], corners: Array, *, cells: int = 8, settings: OcclusionSettings = DEFAULT
) -> tuple[NDArray[np.bool_], float]:
    """The edges of a detected tag that may be a hand's and not its own.

    A hand that covers a tag's white margin and a bit of its border leaves a black square that is a little smaller,
    and still can be read. But beyond a tag's own edge is paper, as bright as beyond its other edges.

    Args:
        image: (height, width) grey levels.
        corners: (4, 2) of the tag [px].
        cells: Cells across the tag, its black border included.
        settings: How dark is too dark for paper.

    Returns:
        (4,) whether the edge from each corner to the next may be hidden; and the width of a cell [px].
    """
    hidden = np.zeros(4, dtype=np.bool_)
    limits = _Limits(**vars(settings))
    width = _compare_sides(image, np.ascontiguousarray(corners, dtype=float), cells, limits, hidden)
    return hidden, float(width)


@kernel
def _compare_sides(
    image: NDArray[np.uint8], corners: Array, cells: int, limits: _Limits, hidden: NDArray[np.bool_]
) -> float:
    """Fill `hidden` (4,) from the brightness on both sides of each edge; returns the width of a cell [px]."""
    n = limits.points
    outer, inner = np.empty((4, n)), np.empty((4, n))
    middle, cell = np.empty(4), np.zeros(4)
    for e in range(4):
        a, b, c, d = corners[e], corners[(e + 1) % 4], corners[(e + 2) % 4], corners[(e + 3) % 4]
        for k in range(n):
            share = (k + 0.5) / n
            x, y = a[0] + share * (b[0] - a[0]), a[1] + share * (b[1] - a[1])
            # from the opposite edge to this one, a cell at a time
            ux = (x - (d[0] + share * (c[0] - d[0]))) / cells
            uy = (y - (d[1] + share * (c[1] - d[1]))) / cells
            cell[e] += np.hypot(ux, uy) / n
            outer[e, k] = grey(image, x + 0.6 * ux, y + 0.6 * uy)
            inner[e, k] = grey(image, x - 0.5 * ux, y - 0.5 * uy)
        middle[e] = np.median(outer[e])
    black = np.median(inner)
    white = np.sort(middle)[2]  # one edge may have a glare beyond it
    for e in range(4):
        share = min(max((cell[e] - limits.small_cell) / (limits.large_cell - limits.small_cell), 0.0), 1.0)
        brightness = limits.brightness_small + share * (limits.brightness - limits.brightness_small)
        least = black + brightness * (white - black)
        hidden[e] = np.sum(outer[e] < least) > limits.hidden_share * n
    return cell.mean()
