"""Tags' corners projected into cameras, with derivatives, and the robust loss of their errors.

Corners are in normalised image coordinates (X/Z, Y/Z). A pose's tangent is rotation [rad] and translation [m] in the
moved frame itself. Of d sightings, arrays have one row each.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tossid.kernels import kernel, part_kernel

Array = NDArray[np.float64]
Ints = NDArray[np.int64]

HUBER = 3.0
"""Whitened residual of a corner beyond which Huber's loss grows linearly, in fits of single poses and in the graph."""
NEAREST = 1e-6
"""Least depth of a corner that is in front of the lens [m]."""


def huber_loss(size: Array) -> Array:
    """Huber's loss of whitened residuals' sizes, of any shape: twice the usual ρ, so squares up to `HUBER`."""
    return np.where(size <= HUBER, size**2, 2 * HUBER * size - HUBER**2)


@part_kernel
def _project(T: Array, x: Array) -> tuple[float, float, float]:
    """X/Z, Y/Z and Z of T x; NaN for the first two behind the lens."""
    X = T[0, 0] * x[0] + T[0, 1] * x[1] + T[0, 2] * x[2] + T[0, 3]
    Y = T[1, 0] * x[0] + T[1, 1] * x[1] + T[1, 2] * x[2] + T[1, 3]
    Z = T[2, 0] * x[0] + T[2, 1] * x[1] + T[2, 2] * x[2] + T[2, 3]
    return (X / Z, Y / Z, Z) if Z > NEAREST else (np.nan, np.nan, Z)


@kernel
def corner_residuals(T: Array, points: Array, seen: Array, whiten: Array) -> tuple[Array, Array]:
    """Whitened residuals of tags' corners, and how they change with the pose.

    Args:
        T: T_cam_target of each sighting, (d, 4, 4).
        points: Corners in the target's frame [m], (d, 4, 3).
        seen: Normalised corners, (d, 4, 2).
        whiten: Takes their errors to unit variance, (d, 4, 2, 2).

    Returns:
        Projected minus seen corners, whitened, (d, 4, 2), NaN behind the lens; and the derivative by the target's
        tangent, (d, 4, 2, 6), 0 there.
    """
    r, J, by_point = np.empty(seen.shape), np.zeros((len(T), 4, 2, 6)), np.empty((2, 3))
    for d in range(len(T)):
        for c in range(4):
            u, v, Z = _project(T[d], points[d, c])
            e, W, x = (u - seen[d, c, 0], v - seen[d, c, 1]), whiten[d, c], points[d, c]
            for i in range(2):
                r[d, c, i] = W[i, 0] * e[0] + W[i, 1] * e[1]
            if not Z > NEAREST:
                continue
            for j in range(3):
                du, dv = (T[d, 0, j] - u * T[d, 2, j]) / Z, (T[d, 1, j] - v * T[d, 2, j]) / Z
                by_point[0, j], by_point[1, j] = W[0, 0] * du + W[0, 1] * dv, W[1, 0] * du + W[1, 1] * dv
            for i in range(2):  # the tangent moves the point by θ × x + v
                a, b = by_point[i], J[d, c, i]
                b[0], b[1], b[2] = x[1] * a[2] - x[2] * a[1], x[2] * a[0] - x[0] * a[2], x[0] * a[1] - x[1] * a[0]
                b[3:] = a
    return r, J


@kernel
def contradictions(
    candidates: Array, of: Ints, by: Ints, T_cam_parent: Array, points: Array, seen: Array, tolerance: Array
) -> Array:
    """How much sightings contradict candidate poses: Geman and McClure's loss over corners, (k,).

    Args:
        candidates: T_parent_target, (k, 4, 4); NaN where there is none.
        of: Which candidate each pair judges, (p,).
        by: The sighting by which it does, (p,).
        T_cam_parent: Of each sighting, (d, 4, 4).
        points: Corners in the target's frame [m], (d, 4, 3).
        seen: Normalised corners, (d, 4, 2).
        tolerance: Residual of each sighting at which the loss is a half, (d,).
    """
    total = np.zeros(len(candidates))
    for p in range(len(of)):
        k, d = of[p], by[p]
        if not np.isfinite(candidates[k, 0, 0]):
            total[k] = np.inf
            continue
        T = T_cam_parent[d] @ candidates[k]
        for c in range(4):
            u, v, _ = _project(T, points[d, c])
            square = ((u - seen[d, c, 0]) ** 2 + (v - seen[d, c, 1]) ** 2) / tolerance[d] ** 2
            total[k] += square / (1 + square) if np.isfinite(square) else 1.0
    return total
