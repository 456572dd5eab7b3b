"""Half-spaces that hold an object, from poses over the ground, and their intersection.

No point x of an object is ever below the ground: p_z + e_z · R x ≥ 0 in every frame, with the body's origin p and its
rotation R. With the downward direction in the body's frame, d = -Rᵀ e_z, this reads d · x ≤ p_z.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linprog, nnls
from scipy.spatial import HalfspaceIntersection, QhullError

from tossid.errors import InputError
from tossid.rotations import quat_to_matrix
from tossid.types import PoseTrack, Toss

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]

LARGEST, SMALLEST = 5.0, 1e-3
"""Farthest that an object may reach from its frame's origin [m], and smallest radius of the largest ball inside."""
OTHER_ANGLE, OTHER_HEIGHT = 8.7e-3, 2e-4
"""Turn [rad] and change of height [m] from the last frame that counted after which a frame of a toss counts again."""


class HalfSpaces(NamedTuple):
    """What frames say of the shape: down · x ≤ height for every point x of the object.

    Attributes:
        down: (n, 3) the world's downward direction in the body's frame, unit.
        height: (n,) of the body's origin above the ground [m].
        place: (n, 2) where over the ground the body's origin is [m].
        toss: (n,) index of the toss.
        free: (n,) whether the frame is known to be in free flight: it bounds the shape, and shows no contact.
    """

    down: Array
    height: Array
    place: Array
    toss: NDArray[np.int64]
    free: Bools

    def chosen(self, which: Bools) -> HalfSpaces:
        """Some of them."""
        return HalfSpaces(self.down[which], self.height[which], self.place[which], self.toss[which], self.free[which])


def half_spaces(tosses: Sequence[Toss | PoseTrack], flying: Sequence[Bools] | None = None) -> HalfSpaces:
    """The half-spaces of all frames of tosses of one rigid body.

    Args:
        tosses: Their configurations, in a world whose z points up and whose ground is z = 0.
        flying: Which frames of each toss are known to be in free flight, (n,); None where it is not known.
    """
    q = np.concatenate([toss.q for toss in tosses])
    down = -quat_to_matrix(q[:, 3:7])[:, 2, :]
    free = np.zeros(len(q), dtype=bool) if flying is None else np.concatenate(list(flying))
    of = np.repeat(np.arange(len(tosses)), [len(toss.t) for toss in tosses])
    return HalfSpaces(down, q[:, 2], q[:, :2], of, free)


def outer_hull(spaces: HalfSpaces) -> tuple[Array, float, Array]:
    """The intersection of half-spaces: everything where the object may be.

    Returns:
        Centre (3,) and radius [m] of the largest ball inside, and the vertices (m, 3), in the body's frame.

    Raises:
        InputError: The half-spaces have no common inside: the ground is not z = 0, or the poses contradict each other.
    """
    normals = np.concatenate([spaces.down, np.eye(3), -np.eye(3)])
    bounds = np.concatenate([spaces.height, np.full(6, LARGEST)])
    # Chebyshev's centre: the largest radius r with n · c + r <= b for every half-space
    cost, columns = np.array([0.0, 0.0, 0.0, -1.0]), np.column_stack([normals, np.ones(len(normals))])
    found = linprog(cost, A_ub=columns, b_ub=bounds, bounds=[(None, None)] * 3 + [(0, None)])
    if found.status != 0 or found.x[3] < SMALLEST:
        raise InputError(
            "no shape fits above the ground in all frames; expected poses over the level ground z = 0, of a body whose "
            "frame does not move in it"
        )
    vertices = _vertices(normals, bounds, found.x[:3])
    if np.abs(vertices).max() >= LARGEST - 1e-9:
        raise InputError(
            f"the frames show the object from too few sides to bound it within {LARGEST:g} m; "
            "expected tosses that come down on all sides"
        )
    return found.x[:3], float(found.x[3]), np.unique(vertices.round(7), axis=0)


def hull_in_box(spaces: HalfSpaces, low: Array, high: Array, axes: Array | None = None) -> Array:
    """Vertices (m, 3) of the intersection of half-spaces and a box, also where they alone bound nothing [m].

    Args:
        spaces: Any number that the middle of the box lies inside of; others are left out.
        low: (3,) where the box begins along each of its axes [m].
        high: (3,) where it ends [m].
        axes: (3, 3) rows are its axes in the body's frame, unit; None for the frame's own.

    Raises:
        InputError: There is no intersection.
    """
    axes = np.eye(3) if axes is None else axes
    inside = axes.T @ (0.5 * (low + high))
    around = spaces.chosen(spaces.height - spaces.down @ inside > 0)
    bounds = np.concatenate([around.height, high, -low])
    return _vertices(np.concatenate([around.down, axes, -axes]), bounds, inside)


def _vertices(normals: Array, bounds: Array, inside: Array) -> Array:
    """Vertices of {x : normals · x ≤ bounds}, given a point inside."""
    try:
        vertices = HalfspaceIntersection(np.column_stack([normals, -bounds]), inside).intersections
    except QhullError as error:
        raise InputError(f"the frames' half-spaces have no hull: {str(error).splitlines()[0]}") from error
    return np.asarray(vertices[np.isfinite(vertices).all(axis=1)])


def different(spaces: HalfSpaces) -> Bools:
    """Marks frames (n,) that differ from the last one marked of their toss: a body at rest is one observation.

    Args:
        spaces: Of all frames, toss after toss.
    """
    keep = np.zeros(len(spaces.height), dtype=bool)
    least, last = np.cos(OTHER_ANGLE), -1
    for k in range(len(keep)):
        keep[k] = (
            last < 0
            or spaces.toss[k] != spaces.toss[last]
            or spaces.down[k] @ spaces.down[last] < least
            or abs(spaces.height[k] - spaces.height[last]) > OTHER_HEIGHT
        )
        last = k if keep[k] else last
    return keep


def evenly(n: int, most: int) -> Bools:
    """Marks at most so many of n items, evenly spaced, (n,)."""
    keep = np.zeros(n, dtype=bool)
    keep[np.unique(np.linspace(0, n - 1, min(n, most)).astype(int))] = True
    return keep


def turned(ways: Array, least: float) -> Bools:
    """Marks directions (n,) that are turned from the last one marked; the first one is.

    Args:
        ways: (n, 3) unit vectors, in their order in time.
        least: By at least this angle [rad].
    """
    keep, last = np.zeros(len(ways), dtype=bool), None
    for k, way in enumerate(ways):
        keep[k] = last is None or way @ last < np.cos(least)
        last = way if keep[k] else last
    return keep


def protrusion(points: Array, vertices: Array) -> Array:
    """Distance (m,) of points (m, 3) from the convex hull of vertices (n, 3) [m]."""
    # the nearest point is a convex combination of vertices; a heavy row makes its weights sum to 1
    heavy = 1e3 * np.abs(vertices).max()
    columns = np.vstack([vertices.T, np.full(len(vertices), heavy)])
    nearest = [vertices.T @ nnls(columns, np.append(point, heavy))[0] for point in points]
    return np.array([np.linalg.norm(near - point) for near, point in zip(nearest, points, strict=True)])
