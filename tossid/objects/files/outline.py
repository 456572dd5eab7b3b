"""The corners of a convex hull that matter: those that stand out from the others."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull, QhullError

from tossid import budget
from tossid.errors import ObjectError
from tossid.objects.roundness import directions

Array = NDArray[np.float64]

_FLAT = 1e-6
"""Share of the size up to which a hull may be lower: single precision leaves that much where faces are divided."""


def hull_vertices(points: Array, options: str = "Qt") -> Array:
    """Vertices (n, 3) of the convex hull of points.

    Args:
        points: (m, 3).
        options: Of Qhull.

    Raises:
        ObjectError: They span no volume.
    """
    try:
        return points[ConvexHull(points, qhull_options=options).vertices]
    except (QhullError, ValueError) as error:
        raise ObjectError(f"its {len(points)} vertices span no volume") from error


def outline(points: Array) -> Array:
    """Vertices (n, 3) of the convex hull of points, without those that single precision alone makes.

    Of more than `ReadLimits.corners` of them, the farthest in as many directions over the sphere stay: of a ball, whose
    vertices are the most, the hull is then lower by a thousandth of its size at most.

    Args:
        points: (m, 3) [m].

    Raises:
        ObjectError: They span no volume.
    """
    found = hull_vertices(points)
    most = budget.limits().corners
    if len(found) > most:
        farthest = np.argmax(directions(most) @ (found - found.mean(axis=0)).T, axis=1)
        found = hull_vertices(found[np.unique(farthest)])
    return hull_vertices(found, f"Qt C-{_FLAT * np.ptp(found, axis=0).max():.3e}")
