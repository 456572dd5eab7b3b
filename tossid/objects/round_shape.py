"""Round shapes from nothing but poses over the ground, beside the polytope of `tossid.objects.polytope`.

Contact shows the support function h(d) of an object. Of a round one, a polytope needs ever more vertices. Two families
of few numbers stand beside it:

- an ellipsoid, h(d) = c . d + |Lᵀ d|;
- what a ball of radius r sweeps over a cylinder of axis n, half length l and radius ρ,
  h(d) = c . d + l |n . d| + ρ |d - (n . d) n| + r. With numbers of it at zero it is a sphere, a capsule, a disc with a
  round edge, or a cylinder.

Each is fitted to the frames by the loss of the polytope, and the Bayesian information criterion chooses.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tossid.objects.half_spaces import HalfSpaces
from tossid.objects.polytope import CONVERGED, FIRST_GAP, GAP, ITERATIONS, loss_of, touching, weights_of
from tossid.objects.roundness import RIM, Roundness, ball, directions, disc, ellipsoid, farthest, joined

Array = NDArray[np.float64]


class RoundShape(NamedTuple):
    """A round shape that was fitted.

    Attributes:
        kind: What it is called.
        corner_pos: (n_c, 3) its corners [m].
        roundness: What stands there.
        size: How many numbers it has.
        gap: (n,) distance of the lowest point from the ground in each frame [m].
        loss: Sum of the loss over frames.
        covariance: Of the numbers, for a misfit of 1 m.
        slope: Derivative of the support function with respect to the numbers (k, count), given directions (k, 3).
    """

    kind: str
    corner_pos: Array
    roundness: Roundness
    size: int
    gap: Array
    loss: float
    covariance: Array
    slope: Callable[[Array], Array]


class _Family(NamedTuple):
    kind: str
    start: Array
    support: Callable[[Array, Array], Array]
    """(numbers, directions (k, 3)) -> (k,)."""
    corners: Callable[[Array], tuple[Array, Roundness]]


def support(corner_pos: Array, roundness: Roundness, ways: Array) -> Array:
    """How far round corners (n_c, 3) reach in some directions (k, 3), unit: (k,) [m]."""
    return np.asarray(np.einsum("ki,kci->kc", ways, farthest(corner_pos, roundness, ways)).max(axis=1))


def round_shapes(spaces: HalfSpaces, hull: Array) -> Iterator[RoundShape]:
    """Round shapes that were fitted to frames.

    Args:
        spaces: Frames near the ground.
        hull: (m, 3) vertices of the outer hull [m].

    Yields:
        One of each family and each start that leads somewhere.
    """
    for family in _families(hull):
        p = _fitted(family, spaces)
        gap = spaces.height - family.support(p, spaces.down)
        if not np.isfinite(gap).all():
            continue
        J = _slope(family, p, spaces.down[touching(gap, spaces.free)])
        if len(J) < 3 * len(p):
            continue
        loss = float(loss_of(gap, spaces.free, GAP).sum())
        covariance: Array = np.asarray(np.linalg.pinv(J.T @ J), dtype=float)

        def slope(ways: Array, family: _Family = family, p: Array = p) -> Array:
            return _slope(family, p, ways)

        yield RoundShape(family.kind, *family.corners(p), len(p), gap, loss, covariance, slope)


def _fitted(family: _Family, spaces: HalfSpaces) -> Array:
    """The numbers of a family that fit frames best, by reweighted least squares with steps of limited length."""
    p, scale = family.start.copy(), FIRST_GAP
    for _ in range(2 * ITERATIONS):
        scale = max(GAP, 0.85 * scale)
        r, J = spaces.height - family.support(p, spaces.down), _slope(family, p, spaces.down)
        w = weights_of(r, spaces.free, scale)
        H = J.T @ (w[:, None] * J)
        step = np.linalg.solve(H + 1e-6 * np.diag(np.diag(H)) + 1e-9 * np.eye(len(p)), J.T @ (w * r))
        change = float(np.abs(J @ step).max())
        p += step * min(1.0, FIRST_GAP * 3 / max(change, 1e-12))
        if scale == GAP and change < CONVERGED:
            break
    return p


def _slope(family: _Family, p: Array, ways: Array) -> Array:
    """Derivative (k, n) of the support function, by central differences."""
    steps = 1e-6 * np.eye(len(p))
    columns = [(family.support(p + e, ways) - family.support(p - e, ways)) / 2e-6 for e in steps]
    return np.column_stack(columns)


def _families(hull: Array) -> Iterator[_Family]:
    """Each family with its starts, from the moments of the outer hull."""
    ways = directions(500)
    reach = (ways @ hull.T).max(axis=1)
    # over the sphere, the mean of d h(d) is a third of the centre: d dᵀ has the mean 1/3
    middle = 3 * (ways * reach[:, None]).mean(axis=0)  # of a symmetric shape
    points = hull[(ways @ hull.T).argmax(axis=1)]
    L = np.linalg.cholesky(3 * np.cov(points.T) + 1e-8 * np.eye(3))
    yield _Family("ellipsoid", np.concatenate([middle, L[np.tril_indices(3)]]), _ellipsoid_support, _ellipsoid_corners)
    _, axes = np.linalg.eigh(np.cov(points.T))
    for k in range(3):
        n, across = axes[:, k], np.delete(axes, k, axis=1)
        half = 0.5 * float(np.ptp(hull @ n))
        wide = 0.25 * sum(float(np.ptp(hull @ across[:, i])) for i in range(2))
        edge = 0.3 * min(half, wide)
        frame = np.column_stack([across, n])
        starts = {
            "capsule": (half - min(wide, 0.9 * half), None, wide),
            "rounded disc": (None, wide - min(half, 0.9 * wide), half),
            "cylinder": (half, wide, None),
            "rounded cylinder": (half - edge, wide - edge, edge),
        }
        if k == 0:
            yield _swept("sphere", middle, frame, (None, None, (half + 2 * wide) / 3))
        for kind, sizes in starts.items():
            yield _swept(kind, middle, frame, sizes)


def _lower_triangle(numbers: Array) -> Array:
    L = np.zeros((3, 3))
    L[np.tril_indices(3)] = numbers
    return L


def _ellipsoid_support(p: Array, ways: Array) -> Array:
    return np.asarray(ways @ p[:3] + np.linalg.norm(ways @ _lower_triangle(p[3:]), axis=1))


def _ellipsoid_corners(p: Array) -> tuple[Array, Roundness]:
    axes, sizes, _ = np.linalg.svd(_lower_triangle(p[3:]))
    return p[None, :3].copy(), ellipsoid(sizes, axes)


def _swept(kind: str, middle: Array, frame: Array, sizes: tuple[float | None, float | None, float | None]) -> _Family:
    """A family of a ball swept over a cylinder: sizes are half length, radius and edge, None for what is zero.

    The numbers are the middle (3), two tilts of the axis where it matters, and the sizes.
    """
    tilted = 2 if sizes[0] is not None or sizes[1] is not None else 0
    free = [i for i, size in enumerate(sizes) if size is not None]
    start = np.concatenate([middle, np.zeros(tilted), [size for size in sizes if size is not None]])

    def parts(p: Array) -> tuple[Array, Array, Array]:
        n = frame[:, 2].copy()
        if tilted:
            n += frame[:, :2] @ p[3:5]
        found = np.zeros(3)
        found[free] = np.abs(p[3 + tilted :])
        return p[:3], n / np.linalg.norm(n), found

    def support_of(p: Array, ways: Array) -> Array:
        c, n, (half, radius, edge) = parts(p)
        along = ways @ n
        across = np.sqrt(np.maximum(1 - along**2, 0))
        return np.asarray(ways @ c + half * np.abs(along) + radius * across + edge)

    def corners(p: Array) -> tuple[Array, Roundness]:
        c, n, (half, radius, edge) = parts(p)
        ends = [c] if half == 0 else [c - half * n, c + half * n]
        each = ball(edge) if radius == 0 else disc(radius, n, edge)
        count = 1 if radius == 0 else RIM
        return np.repeat(np.array(ends), count, axis=0), joined([each] * len(ends))

    return _Family(kind, start, support_of, corners)
