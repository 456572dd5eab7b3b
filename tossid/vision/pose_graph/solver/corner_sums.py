"""Sums over the corners of many tags, for poses that many sightings share: kernels of `resect`.

`resect.residuals` is the plain form of what they sum up; tests compare both. Arrays are those of `resect.Sightings`.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tossid.kernels import kernel

Array = NDArray[np.float64]
Ints = NDArray[np.int64]

BEHIND = 1e6
"""Whitened residual that stands for that of a corner behind the lens."""


@kernel
def _product(A: Array, B: Array, out: Array) -> None:
    """The first three rows of A B."""
    for i in range(3):
        for j in range(4):
            out[i, j] = A[i, 0] * B[0, j] + A[i, 1] * B[1, j] + A[i, 2] * B[2, j]
        out[i, 3] += A[i, 3]


@kernel
def _flat(T: Array, x: Array, out: Array) -> None:
    """X/Z, Y/Z and Z of T x."""
    for i in range(3):
        out[i] = T[i, 0] * x[0] + T[i, 1] * x[1] + T[i, 2] * x[2] + T[i, 3]
    if out[2] > 0:
        out[0] /= out[2]
        out[1] /= out[2]


@kernel
def residual_sizes(group: Ints, T_cam_parent: Array, T: Array, points: Array, seen: Array, whiten: Array) -> Array:
    """Norms of the whitened residuals of corners, (d, 4).

    Args:
        group: Pose of each sighting, (d,).
        T_cam_parent: (d, 4, 4).
        T: T_parent_target of each pose, (g, 4, 4).
        points: Corners in the target's frame [m], (d, 4, 3).
        seen: Normalised corners, (d, 4, 2).
        whiten: (d, 4, 2, 2).
    """
    size = np.empty((len(group), 4))
    T_cam_target, y = np.empty((3, 4)), np.empty(3)
    for d in range(len(group)):
        _product(T_cam_parent[d], T[group[d]], T_cam_target)
        bad = False
        for c in range(4):
            _flat(T_cam_target, points[d, c], y)
            bad |= not y[2] > 0
            e0, e1 = y[0] - seen[d, c, 0], y[1] - seen[d, c, 1]
            W = whiten[d, c]
            size[d, c] = np.sqrt((W[0, 0] * e0 + W[0, 1] * e1) ** 2 + (W[1, 0] * e0 + W[1, 1] * e1) ** 2)
        if bad or not np.isfinite(size[d].sum()):
            size[d] = BEHIND
    return size


@kernel
def normal_equations(
    group: Ints, T_cam_parent: Array, T: Array, points: Array, seen: Array, whiten: Array, size: Array, limit: Array
) -> tuple[Array, Array]:
    """Σ w JᵀJ and Σ w Jᵀr of each pose, with Huber's weights w = min(1, limit / size), (g, 6, 6) and (g, 6).

    r are the whitened residuals, J their derivative by the target's tangent (rotation, translation). A sighting with a
    corner behind the lens has no weight.

    Args:
        group: As in `residual_sizes`.
        T_cam_parent: Likewise.
        T: Likewise.
        points: Likewise.
        seen: Likewise.
        whiten: Likewise.
        size: Of `residual_sizes`, (d, 4).
        limit: Huber's threshold of each pose, (g,).
    """
    information, gradient = np.zeros((len(T), 6, 6)), np.zeros((len(T), 6))
    T_cam_target, y, row, J = np.empty((3, 4)), np.empty(3), np.empty(3), np.empty(6)
    for d in range(len(group)):
        g = group[d]
        if size[d, 0] >= BEHIND:
            continue
        _product(T_cam_parent[d], T[g], T_cam_target)
        for c in range(4):
            x, W = points[d, c], whiten[d, c]
            _flat(T_cam_target, x, y)
            e0, e1 = y[0] - seen[d, c, 0], y[1] - seen[d, c, 1]
            weight = min(1.0, limit[g] / max(size[d, c], 1e-12))
            for i in range(2):
                r = W[i, 0] * e0 + W[i, 1] * e1
                for j in range(3):
                    along = W[i, 0] * (T_cam_target[0, j] - y[0] * T_cam_target[2, j])
                    along += W[i, 1] * (T_cam_target[1, j] - y[1] * T_cam_target[2, j])
                    row[j] = along / y[2]
                    J[3 + j] = row[j]
                J[0] = row[2] * x[1] - row[1] * x[2]  # -row · x^
                J[1] = row[0] * x[2] - row[2] * x[0]
                J[2] = row[1] * x[0] - row[0] * x[1]
                for a in range(6):
                    gradient[g, a] += weight * J[a] * r
                    for b in range(a + 1):
                        information[g, a, b] += weight * J[a] * J[b]
    for g in range(len(T)):
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
        T_cam_parent: (d, 4, 4).
        points: (d, 4, 3).
        seen: (d, 4, 2).
        tolerance: Residual of each sighting at which the loss is a half, (d,).
    """
    total = np.zeros(len(candidates))
    T_cam_target, y = np.empty((3, 4)), np.empty(3)
    for p in range(len(of)):
        k, d = of[p], by[p]
        if not np.isfinite(candidates[k, 0, 0]):
            total[k] = np.inf
            continue
        _product(T_cam_parent[d], candidates[k], T_cam_target)
        for c in range(4):
            _flat(T_cam_target, points[d, c], y)
            if y[2] > 0:
                square = ((y[0] - seen[d, c, 0]) ** 2 + (y[1] - seen[d, c, 1]) ** 2) / tolerance[d] ** 2
                total[k] += square / (1 + square) if np.isfinite(square) else 1.0
            else:
                total[k] += 1.0
    return total
