"""Wireframes of convex bodies, and orthographic views of them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull, QhullError

from tossid.objects import ObjectModel, body_poses
from tossid.rotations import quat_rotate

Array = NDArray[np.float64]

FLAT_COS = 0.999
"""Facets whose normals are closer than this (cosine) are one face."""


@dataclass(frozen=True)
class Wireframe:
    """Edges of the convex hull of a body's corners.

    Attributes:
        edges: Corner indices (n_e, 2).
        normals: Outward normals (n_e, 2, 3), in the body's frame, of the two faces that meet there; zero where the
            corners span no volume.
    """

    edges: NDArray[np.int64]
    normals: Array

    def visible(self, quat: Array, toward: Array) -> NDArray[np.bool_]:
        """Whether each edge (n_e,) is on the viewer's side.

        Args:
            quat: The body's orientation (4,), wxyz.
            toward: Direction to the viewer (3,), in the world.
        """
        return np.asarray(np.any(quat_rotate(quat, self.normals) @ toward > -1e-9, axis=1))


def wireframe(corners: Array) -> Wireframe:
    """The wireframe of a body with corners (n, 3) [m]; if they span no volume, each is joined to each."""
    try:
        hull = ConvexHull(corners)
    except (QhullError, ValueError):
        pairs = np.array([(i, j) for i in range(len(corners)) for j in range(i)], dtype=np.int64).reshape(-1, 2)
        return Wireframe(pairs, np.zeros((len(pairs), 2, 3)))
    facets: dict[tuple[int, int], list[int]] = {}
    for f, simplex in enumerate(hull.simplices):
        for a in range(3):
            i, j = sorted((int(simplex[a]), int(simplex[(a + 1) % 3])))
            facets.setdefault((i, j), []).append(f)
    outward = hull.equations[:, :3]
    sharp = {e: fs for e, fs in facets.items() if outward[fs[0]] @ outward[fs[-1]] < FLAT_COS}
    normals = np.array([[outward[f[0]], outward[f[-1]]] for f in sharp.values()])
    return Wireframe(np.array(list(sharp), dtype=np.int64), normals)


def wireframes(model: ObjectModel) -> list[Wireframe]:
    """The wireframe of each body of an object, as it is drawn."""
    drawn = model.drawn
    return [wireframe(drawn.corner_pos[drawn.corner_body == b]) for b in range(model.n_bodies)]


@dataclass(frozen=True)
class View:
    """An orthographic view: called with points (..., 3), it gives their places on paper (..., 2), right and up.

    Attributes:
        plane: Directions to the right and up on paper (2, 3).
        toward: Direction to the viewer (3,).
    """

    plane: Array
    toward: Array

    def __call__(self, points: Array) -> Array:
        """Places on paper (..., 2) of points (..., 3)."""
        return points @ self.plane.T


def view_from(azimuth: float, elevation: float) -> View:
    """The view from a direction.

    Args:
        azimuth: Direction of the viewer, 0 for +x, π/2 for +y [rad].
        elevation: Height of the viewer over the horizon [rad].
    """
    ca, sa, ce, se = np.cos(azimuth), np.sin(azimuth), np.cos(elevation), np.sin(elevation)
    return View(np.array([[-sa, ca, 0.0], [-se * ca, -se * sa, ce]]), np.array([ce * ca, ce * sa, se]))


def posed(model: ObjectModel, q: Array) -> list[tuple[Array, Array]]:
    """For each body in a configuration (nq,), its corners in the world (n, 3) [m] and its orientation (4,), wxyz."""
    position, quat = body_poses(model, q)
    drawn = model.drawn
    return [
        (position[b] + quat_rotate(quat[b], drawn.corner_pos[drawn.corner_body == b]), quat[b])
        for b in range(model.n_bodies)
    ]
