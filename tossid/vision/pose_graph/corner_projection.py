"""Tags' corners projected into cameras, with derivatives: the inner loops of tracking (Numba).

Corners are in normalised image coordinates (X/Z, Y/Z). A pose's tangent is GTSAM's: rotation [rad] and translation [m]
in the moved frame itself, T · exp(ξ). Of d sightings, arrays have one row each.
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
BEHIND = 1e6
"""Whitened residual that stands for that of a tag with a corner behind the lens."""


@part_kernel
def _project(T: Array, x: Array) -> tuple[float, float, float]:
    """X/Z, Y/Z and Z of T x; NaN for the first two behind the lens."""
    X = T[0, 0] * x[0] + T[0, 1] * x[1] + T[0, 2] * x[2] + T[0, 3]
    Y = T[1, 0] * x[0] + T[1, 1] * x[1] + T[1, 2] * x[2] + T[1, 3]
    Z = T[2, 0] * x[0] + T[2, 1] * x[1] + T[2, 2] * x[2] + T[2, 3]
    if not Z > NEAREST:
        return np.nan, np.nan, Z
    return X / Z, Y / Z, Z


@kernel
def project_tag(T: Array, points: Array, flat: Array, J: Array) -> None:
    """Fill in the projections of a tag's corners, and how they change with the pose.

    Args:
        T: T_cam_target, (4, 4).
        points: Corners in the target's frame [m], (4, 3).
        flat: Written: normalised coordinates, (4, 2); NaN behind the lens.
        J: Written: their derivative by the target's tangent, (4, 2, 6); 0 behind the lens.
    """
    for c in range(4):
        x = points[c]
        flat[c, 0], flat[c, 1], Z = _project(T, x)
        if not Z > NEAREST:
            J[c] = 0.0
            continue
        for i in range(2):
            # d flat / d x, a row (a, b, d); the tangent moves x by θ × x + v
            a = (T[i, 0] - flat[c, i] * T[2, 0]) / Z
            b = (T[i, 1] - flat[c, i] * T[2, 1]) / Z
            d = (T[i, 2] - flat[c, i] * T[2, 2]) / Z
            J[c, i, 0], J[c, i, 1], J[c, i, 2] = d * x[1] - b * x[2], a * x[2] - d * x[0], b * x[0] - a * x[1]
            J[c, i, 3], J[c, i, 4], J[c, i, 5] = a, b, d


@kernel
def corner_errors(T: Array, points: Array, seen: Array) -> Array:
    """Projected minus seen corners, (d, 4, 2); NaN behind the lens.

    Args:
        T: T_cam_target of each sighting, (d, 4, 4).
        points: Corners in the target's frame [m], (d, 4, 3).
        seen: Normalised corners, (d, 4, 2).
    """
    out = np.empty(seen.shape)
    for d in range(len(T)):
        for c in range(4):
            u, v, _ = _project(T[d], points[d, c])
            out[d, c, 0], out[d, c, 1] = u - seen[d, c, 0], v - seen[d, c, 1]
    return out


@kernel
def whitened_sizes(T: Array, points: Array, seen: Array, whiten: Array) -> Array:
    """Norms of the whitened residuals of corners, (d, 4); `BEHIND` for all four if one is behind the lens.

    Args:
        T: As in `corner_errors`.
        points: Likewise.
        seen: Likewise.
        whiten: Takes errors of corners to unit variance, (d, 4, 2, 2).
    """
    size = np.empty((len(T), 4))
    for d in range(len(T)):
        for c in range(4):
            u, v, _ = _project(T[d], points[d, c])
            e0, e1, W = u - seen[d, c, 0], v - seen[d, c, 1], whiten[d, c]
            size[d, c] = np.hypot(W[0, 0] * e0 + W[0, 1] * e1, W[1, 0] * e0 + W[1, 1] * e1)
        if not np.isfinite(size[d].sum()):
            size[d] = BEHIND
    return size


@kernel
def normal_equations(
    group: Ints, n: int, T: Array, points: Array, seen: Array, whiten: Array, size: Array, limit: Array
) -> tuple[Array, Array]:
    """Σ w JᵀJ and Σ w Jᵀr of n poses, with Huber's weights w = min(1, limit / size), (n, 6, 6) and (n, 6).

    r are the whitened residuals, J their derivative by the target's tangent. A tag behind the lens has no weight.

    Args:
        group: Which of the poses each sighting belongs to, (d,).
        n: Number of poses.
        T: As in `corner_errors`.
        points: Likewise.
        seen: Likewise.
        whiten: As in `whitened_sizes`.
        size: Of `whitened_sizes`, (d, 4).
        limit: Huber's threshold of each pose, (n,).
    """
    information, gradient = np.zeros((n, 6, 6)), np.zeros((n, 6))
    flat, J, row = np.empty((4, 2)), np.empty((4, 2, 6)), np.empty(6)
    for d in range(len(T)):
        if size[d, 0] >= BEHIND:
            continue
        g = group[d]
        project_tag(T[d], points[d], flat, J)
        for c in range(4):
            e0, e1, W = flat[c, 0] - seen[d, c, 0], flat[c, 1] - seen[d, c, 1], whiten[d, c]
            weight = min(1.0, limit[g] / max(size[d, c], 1e-12))
            for i in range(2):
                r = W[i, 0] * e0 + W[i, 1] * e1
                for a in range(6):
                    row[a] = W[i, 0] * J[c, 0, a] + W[i, 1] * J[c, 1, a]
                    gradient[g, a] += weight * row[a] * r
                    for b in range(a + 1):
                        information[g, a, b] += weight * row[a] * row[b]
    for g in range(n):
        for a in range(6):
            for b in range(a):
                information[g, b, a] = information[g, a, b]
    return information, gradient


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
