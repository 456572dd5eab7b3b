"""Round shapes from nothing but poses over the ground, beside the polytope of `convex_shape`.

Contact shows the support function h(d) of an object (`convex_shape`). Of a round one, a polytope needs ever more
vertices. Two families of few numbers stand beside it:

- an ellipsoid, h(d) = c . d + |Lᵀ d|;
- what a ball of radius r sweeps over a cylinder of axis n, half length l and radius ρ,
  h(d) = c . d + l |n . d| + ρ |d - (n . d) n| + r. With numbers of it at zero it is a sphere, a capsule, a disc with a
  round edge, or a cylinder.

Each is fitted to the frames by the loss of the polytope, and the Bayesian information criterion chooses.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from tossid.objects.roundness import RIM, Roundness, ball, directions, disc, ellipsoid, joined
from tossid.settings.objects import ShapeSettings

Array = NDArray[np.float64]
Loss = Callable[[Array, NDArray[np.bool_], float, ShapeSettings], Array]
"""Loss, or weight, of each gap (n,), given which frames fly freely and its scale above the ground [m]."""


class Frames(Protocol):
    """Frames near the ground, see `convex_shape.HalfSpaces`."""

    @property
    def down(self) -> Array:
        """(n, 3) the downward direction in the body's frame."""

    @property
    def height(self) -> Array:
        """(n,) of the body's origin [m]."""

    @property
    def free(self) -> NDArray[np.bool_]:
        """(n,) whether the frame is in free flight."""


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


def round_shapes(
    spaces: Frames, hull: Array, settings: ShapeSettings, *, loss: Loss, weights: Loss
) -> Iterator[RoundShape]:
    """Round shapes that were fitted to frames.

    Args:
        spaces: Frames near the ground.
        hull: (m, 3) vertices of the outer hull [m].
        settings: Noise, scales and iterations.
        loss: Of gaps.
        weights: Of the least squares with the same gradient.

    Yields:
        One of each family and each start that leads somewhere.
    """
    down, height, free = spaces.down, spaces.height, spaces.free
    for family in _families(hull):
        p, scale = family.start.copy(), settings.first_gap
        for _ in range(2 * settings.iterations):
            scale = max(settings.gap, 0.85 * scale)
            r, J = height - family.support(p, down), _slope(family, p, down)
            w = weights(r, free, scale, settings)
            H = J.T @ (w[:, None] * J)
            step = np.linalg.solve(H + 1e-6 * np.diag(np.diag(H)) + 1e-9 * np.eye(len(p)), J.T @ (w * r))
            p += step * min(1.0, settings.first_gap * 3 / max(float(np.abs(J @ step).max()), 1e-12))
            if scale == settings.gap and np.abs(J @ step).max() < settings.converged:
                break
        r, J = height - family.support(p, down), _slope(family, p, down)
        if not np.isfinite(r).all():
            continue
        J = J[(np.abs(r) < settings.contact_gap) & ~free]
        if len(J) < 3 * len(p):
            continue
        corners, roundness = family.corners(p)
        covariance: Array = np.asarray(np.linalg.pinv(J.T @ J), dtype=float)

        def slope(ways: Array, family: _Family = family, p: Array = p) -> Array:
            return _slope(family, p, ways)

        yield RoundShape(
            family.kind,
            corners,
            roundness,
            len(p),
            r,
            float(loss(r, free, settings.gap, settings).sum()),
            covariance,
            slope,
        )


def support(corner_pos: Array, roundness: Roundness, ways: Array) -> Array:
    """How far round corners reach in some directions [m], (k,).

    Args:
        corner_pos: (n_c, 3) [m].
        roundness: What stands there.
        ways: (k, 3), unit.
    """
    along = ways[:, None] * np.ones((1, len(corner_pos), 1))
    return np.asarray(np.einsum("ki,kci->kc", ways, corner_pos + roundness.offset(along)).max(axis=1))


def surface(corner_pos: Array, roundness: Roundness, ways: Array) -> Array:
    """The farthest points of round corners in some directions [m], (k, 3).

    Args:
        corner_pos: (n_c, 3) [m].
        roundness: What stands there.
        ways: (k, 3), unit.
    """
    points = corner_pos + roundness.offset(ways[:, None] * np.ones((1, len(corner_pos), 1)))
    lowest = np.einsum("ki,kci->kc", ways, points).argmax(axis=1)
    return np.asarray(points[np.arange(len(ways)), lowest])


def _slope(family: _Family, p: Array, ways: Array) -> Array:
    """Derivative (k, n) of the support function, by central differences."""
    J, step = np.empty((len(ways), len(p))), 1e-6
    for i in range(len(p)):
        e = np.zeros(len(p))
        e[i] = step
        J[:, i] = (family.support(p + e, ways) - family.support(p - e, ways)) / (2 * step)
    return J


def _families(hull: Array) -> Iterator[_Family]:
    """Each family with its starts, from the moments of the outer hull."""
    ways = directions(500)
    reach = (ways @ hull.T).max(axis=1)
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


def _ellipsoid_support(p: Array, ways: Array) -> Array:
    L = np.zeros((3, 3))
    L[np.tril_indices(3)] = p[3:]
    return np.asarray(ways @ p[:3] + np.linalg.norm(ways @ L, axis=1))


def _ellipsoid_corners(p: Array) -> tuple[Array, Roundness]:
    L = np.zeros((3, 3))
    L[np.tril_indices(3)] = p[3:]
    axes, sizes, _ = np.linalg.svd(L)
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
