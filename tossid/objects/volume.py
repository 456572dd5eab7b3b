"""The volume that an object takes."""

from __future__ import annotations

from scipy.spatial import ConvexHull, QhullError

from tossid.objects.model import ObjectModel


def hull_volume(model: ObjectModel) -> float:
    """Sum of the volumes of the convex hulls of an object's bodies [m³]; a flat body has none.

    Args:
        model: The object.
    """
    with_corners = (body for body in range(len(model.mass)) if (model.corner_body == body).any())
    return sum(_volume(model, body) for body in with_corners)


def _volume(model: ObjectModel, body: int) -> float:
    """Of one body, which has corners."""
    try:
        return float(ConvexHull(model.hull_points(body)).volume)
    except QhullError:
        return 0.0
