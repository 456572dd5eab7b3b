"""The volume that an object takes."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull, QhullError

from tossid.objects.model import ObjectModel

Array = NDArray[np.float64]

_DIRECTIONS = 2000
"""In which the outermost points of a round body are taken: a ball's volume is then within 0.5 %."""


def hull_volume(model: ObjectModel) -> float:
    """Sum of the volumes of the convex hulls of an object's bodies [m³]; a body that is flat or has no shape has none.

    Args:
        model: The object.
    """
    return sum(_volume(_outermost(model, body)) for body in range(len(model.mass)))


def _outermost(model: ObjectModel, body: int) -> Array:
    """(n, 3) points whose convex hull is the body's, in its frame [m]."""
    own = model.corner_body == body
    corners = model.corner_pos[own]
    if model.roundness is None or not own.any():
        return corners
    down = np.repeat(_sphere(_DIRECTIONS)[:, None], len(corners), axis=1)
    points: Array = corners + model.roundness.of(own).offset(down)
    return points.reshape(-1, 3)


def _sphere(count: int) -> Array:
    """(count, 3) directions that are spread evenly (Fibonacci's lattice)."""
    z = 1 - (2 * np.arange(count) + 1) / count
    turn = np.pi * (1 + np.sqrt(5)) * np.arange(count)
    across = np.sqrt(1 - z**2)
    return np.stack([across * np.cos(turn), across * np.sin(turn), z], axis=1)


def _volume(points: Array) -> float:
    try:
        return float(ConvexHull(points).volume)
    except (QhullError, ValueError):
        return 0.0
