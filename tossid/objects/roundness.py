"""Round parts of a shape: what stands at each corner in place of a point.

The lowest point of a corner at x, with the downward direction d in its body's axes, is

    x + r d + T Q w,      w = Q d / |Q d|:

that of a ball of radius r and, added to it (Minkowski's sum), of the ellipsoid {Q y: |y| <= 1}. A ball has Q = 0. A
disc has a Q of rank two: its axis is Q's null space. An ellipsoid has r = 0. The rotation T, about a disc's axis, makes
further points of the same rim, so that a cylinder can stand on its face: MuJoCo, too, takes three. For the ground, an
object is the convex hull of its corners: a capsule is two balls, a cylinder two discs.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]

RIM = 3
"""Points of a disc's rim that may touch the ground at once."""
FLAT = 1e-9
"""|Q d| over |Q| below which a disc lies flat, and all its rim is as low."""


class Roundness(NamedTuple):
    """What stands at each corner.

    Attributes:
        radius: (n_c,) r [m].
        root: (n_c, 3, 3) Q, symmetric [m].
        turned: (n_c, 3, 3) T Q [m].
        flat: (n_c, 3) the direction w of a disc that lies flat.
    """

    radius: Array
    root: Array
    turned: Array
    flat: Array

    def offset(self, down: Array) -> Array:
        """The lowest points from their corners [m].

        Args:
            down: (*b, n_c, 3) the downward direction in each corner's body's axes, unit.

        Returns:
            (*b, n_c, 3).
        """
        w = np.einsum("cij,...cj->...ci", self.root, down)
        size = np.linalg.norm(w, axis=-1, keepdims=True)
        none = size <= FLAT * np.abs(self.root).max(axis=(1, 2))[:, None]
        w = np.where(none, self.flat, w / np.where(none, 1.0, size))
        out: Array = self.radius[:, None] * down + np.einsum("cij,...cj->...ci", self.turned, w)
        return out

    def scaled(self, scale: float) -> Roundness:
        """The same, larger or smaller by a factor."""
        return Roundness(scale * self.radius, scale * self.root, scale * self.turned, self.flat)

    def of(self, which: NDArray[np.bool_]) -> Roundness:
        """That of some corners."""
        return Roundness(*(part[which] for part in self))


def points(count: int) -> Roundness:
    """Corners that are points."""
    nothing = np.zeros((count, 3, 3))
    return Roundness(np.zeros(count), nothing, nothing.copy(), np.tile([1.0, 0.0, 0.0], (count, 1)))


def ball(radius: float) -> Roundness:
    """One corner that is a ball.

    Args:
        radius: [m].
    """
    return points(1)._replace(radius=np.array([float(radius)]))


def ellipsoid(half_axes: ArrayLike, axes: Array | None = None) -> Roundness:
    """One corner that is an ellipsoid.

    Args:
        half_axes: (3,) [m].
        axes: (3, 3) their directions, in columns; the body's if None.
    """
    a = np.eye(3) if axes is None else axes
    root = (a * np.asarray(half_axes, dtype=float)) @ a.T
    return points(1)._replace(root=root[None], turned=root[None].copy())


def disc(radius: float, axis: ArrayLike, edge: float = 0.0) -> Roundness:
    """`RIM` corners in the same place: points of a disc's rim.

    Args:
        radius: Of the disc [m].
        axis: (3,) its axis.
        edge: Radius of a ball that is added to each of its points: a round edge [m].
    """
    n = np.asarray(axis, dtype=float) / np.linalg.norm(axis)
    root = radius * (np.eye(3) - np.outer(n, n))
    cross = np.array([[0.0, -n[2], n[1]], [n[2], 0.0, -n[0]], [-n[1], n[0], 0.0]])
    turned = []
    for k in range(RIM):
        angle = 2 * np.pi * k / RIM
        turned.append((np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross) @ root)
    across = np.eye(3)[np.argmin(np.abs(n))]
    across = across - n * (n @ across)
    flat = np.tile(across / np.linalg.norm(across), (RIM, 1))
    return Roundness(np.full(RIM, float(edge)), np.tile(root, (RIM, 1, 1)), np.array(turned), flat)


def joined(parts: list[Roundness]) -> Roundness:
    """Corners of several parts as one list."""
    return Roundness(*(np.concatenate(each) for each in zip(*parts, strict=True)))


def farthest(corner_pos: Array, roundness: Roundness | None, ways: Array) -> Array:
    """The farthest point of each corner in some directions: (k, n_c, 3) [m].

    Args:
        corner_pos: (n_c, 3) [m].
        roundness: What stands there; None for points.
        ways: (k, 3) directions, unit.
    """
    at = np.broadcast_to(corner_pos, (len(ways), *corner_pos.shape))
    return at if roundness is None else at + roundness.offset(np.broadcast_to(ways[:, None], at.shape))


def directions(count: int) -> Array:
    """Directions spread evenly over the sphere (Fibonacci's lattice), (count, 3)."""
    k = np.arange(count) + 0.5
    z, angle = 1 - 2 * k / count, np.pi * (1 + np.sqrt(5)) * k
    r = np.sqrt(1 - z**2)
    return np.column_stack([r * np.cos(angle), r * np.sin(angle), z])
