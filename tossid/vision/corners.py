"""Sub-pixel corners of a tag: its border's edges measured in the image, fitted straight in
undistorted coordinates, and intersected (Numba)."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from tossid.vision.camera import Camera

Array = NDArray[np.float64]

CONTRAST = 12.0
"""Least step between black border and white margin [grey levels]."""
SPREAD = 1.0
"""Distance [px] over which an edge spreads to each side; the profile keeps twice that from the next cell."""
FLOOR = 0.01
"""Least standard deviation of a corner [px]."""


def refine_corners(image: NDArray[np.uint8], camera: Camera, corners: Array) -> tuple[Array, Array, bool]:
    """Improve a detector's corners.

    Each edge of the black border is found to a fraction of a pixel at about
    one place a pixel along it, from the area under the brightness profile
    across it, x = r - ∫ (I - I_black) / (I_white - I_black), which neither blur
    (of any symmetric kind) nor noise biases. The straight line through the
    undistorted places, and its scatter, give the corners and their covariance.
    Scatter does not show what neighbouring profiles share, nor what the next
    cell's blur adds where cells are small; the covariance is scaled up for both,
    by factors measured on rendered tags (`_inflation`).

    Args:
        image: (height, width). camera: its camera.
        corners: (4, 2) [px], in the order bottom-left, bottom-right, top-right, top-left.

    Returns:
        corners (4, 2) [px], covariances (4, 2, 2) [px²], and whether it worked. Where it
        did not, the corners are as given and the covariances zero.
    """
    refined = np.array(corners, dtype=float)
    cov = np.zeros((4, 2, 2))
    good = _refine(image, camera.rays, refined, cov)
    if not good:
        return np.asarray(corners, dtype=float), np.zeros((4, 2, 2)), False
    return refined, cov + FLOOR**2 * np.eye(2), True


@njit(cache=True, nogil=True)
def _inflation(cell: float) -> float:
    """True over apparent standard deviation of an edge, by cell width across it [px]."""
    return 1.35 + max(0.0, 2.75 - cell)


@njit(cache=True, nogil=True)
def _ray(rays: Array, x: float, y: float, out: Array) -> bool:
    """Bilinear look-up of a pixel's normalised coordinates, and the local d(ray)/d(pixel) row by row."""
    column, row = int(np.floor(x + 0.5)), int(np.floor(y + 0.5))
    if column < 0 or row < 0 or row + 1 >= rays.shape[0] or column + 1 >= rays.shape[1]:
        return False
    fx, fy = x + 0.5 - column, y + 0.5 - row
    for k in range(2):
        a, b = rays[row, column, k], rays[row, column + 1, k]
        c, d = rays[row + 1, column, k], rays[row + 1, column + 1, k]
        out[k] = (1 - fy) * ((1 - fx) * a + fx * b) + fy * ((1 - fx) * c + fx * d)
        out[2 + 2 * k] = (1 - fy) * (b - a) + fy * (d - c)
        out[3 + 2 * k] = (1 - fx) * (c - a) + fx * (d - b)
    return not np.isnan(out[0] + out[1])


@njit(cache=True, nogil=True)
def _edge_places(
    image: NDArray[np.uint8], rays: Array, ax: float, ay: float, bx: float, by: float, cell: float, places: Array
) -> int:
    """Undistorted places of one edge from a to b, inside on its left (up in a y-down image is left)."""
    length = np.hypot(bx - ax, by - ay)
    tx, ty = (bx - ax) / length, (by - ay) / length
    nx, ny = -ty, tx
    reach = min(max(cell - 2 * SPREAD, 0.9), 3.0)
    steps = int(np.ceil(2 * reach / 0.5))
    h = 2 * reach / steps
    start = max(0.06 * length, 0.7 * reach)
    count = min(max(int(length - 2 * start), 4), places.shape[0])
    if length - 2 * start < 3:
        return 0
    profile = np.empty((count, steps + 1))
    height, width = image.shape
    for i in range(count):
        along = start + (length - 2 * start) * i / (count - 1)
        px, py = ax + along * tx, ay + along * ty
        for k in range(steps + 1):
            x, y = px + (k * h - reach) * nx, py + (k * h - reach) * ny
            column, row = int(np.floor(x)), int(np.floor(y))
            if column < 0 or row < 0 or column + 1 >= width or row + 1 >= height:
                return 0
            fx, fy = x - column, y - row
            profile[i, k] = (1 - fy) * ((1 - fx) * image[row, column] + fx * image[row, column + 1]) + fy * (
                (1 - fx) * image[row + 1, column] + fx * image[row + 1, column + 1]
            )
    black, white = 0.0, 0.0
    for i in range(count):
        black += profile[i, 0] / count
        white += profile[i, steps] / count
    if white - black < CONTRAST:
        return 0
    found = 0
    ray = np.empty(6)
    for i in range(count):
        area = 0.0
        for k in range(steps + 1):
            area += (profile[i, k] - black) * (0.5 if k == 0 or k == steps else 1.0)
        offset = reach - h * area / (white - black)
        if abs(offset) > reach:
            continue
        along = start + (length - 2 * start) * i / (count - 1)
        if _ray(rays, ax + along * tx + offset * nx, ay + along * ty + offset * ny, ray):
            places[found, 0], places[found, 1] = ray[0], ray[1]
            found += 1
    return found


@njit(cache=True, nogil=True)
def _fit_line(places: Array, count: int, line: Array) -> bool:
    """Total least squares with one pass of outlier removal.

    line: mean x, mean y, direction x, direction y, variance across, number, sum of squares along.
    """
    keep = np.ones(count, dtype=np.bool_)
    for attempt in range(2):
        n, mx, my = 0, 0.0, 0.0
        for i in range(count):
            if keep[i]:
                n += 1
                mx += places[i, 0]
                my += places[i, 1]
        if n < 4:
            return False
        mx /= n
        my /= n
        sxx, sxy, syy = 0.0, 0.0, 0.0
        for i in range(count):
            if keep[i]:
                dx, dy = places[i, 0] - mx, places[i, 1] - my
                sxx += dx * dx
                sxy += dx * dy
                syy += dy * dy
        angle = 0.5 * np.arctan2(2 * sxy, sxx - syy)
        dx, dy = np.cos(angle), np.sin(angle)
        along = sxx * dx * dx + 2 * sxy * dx * dy + syy * dy * dy
        across = max(sxx + syy - along, 0.0)
        variance = across / (n - 2)
        line[0], line[1], line[2], line[3], line[4], line[5], line[6] = mx, my, dx, dy, variance, n, along
        if attempt == 0:
            limit = 6.25 * variance
            for i in range(count):
                r = -(places[i, 0] - mx) * dy + (places[i, 1] - my) * dx
                keep[i] = r * r <= limit
    return True


@njit(cache=True, nogil=True)
def _refine(image: NDArray[np.uint8], rays: Array, corners: Array, cov: Array) -> bool:
    """Refine corners (4, 2) in place; fill cov (4, 2, 2). Five rounds, each about the last."""
    first = corners.copy()
    lines = np.empty((4, 7))
    places = np.empty((80, 2))
    ray = np.empty(6)
    for _ in range(5):
        for e in range(4):
            a, b, c, d = corners[e], corners[(e + 1) % 4], corners[(e + 2) % 4], corners[(e + 3) % 4]
            length = np.hypot(b[0] - a[0], b[1] - a[1])
            if length < 8:
                return False
            nx, ny = -(b[1] - a[1]) / length, (b[0] - a[0]) / length
            cell = ((a[0] + b[0] - c[0] - d[0]) * nx + (a[1] + b[1] - c[1] - d[1]) * ny) / 16
            if cell < 0.8:
                return False
            count = _edge_places(image, rays, a[0], a[1], b[0], b[1], cell, places)
            if count < 4 or not _fit_line(places, count, lines[e]):
                return False
            lines[e, 4] *= _inflation(cell) ** 2
        for e in range(4):
            p, q = lines[(e + 3) % 4], lines[e]
            # n·x = n·m for both lines
            n1x, n1y, n2x, n2y = -p[3], p[2], -q[3], q[2]
            c1, c2 = n1x * p[0] + n1y * p[1], n2x * q[0] + n2y * q[1]
            det = n1x * n2y - n1y * n2x
            if abs(det) < 0.05:
                return False
            x, y = (c1 * n2y - c2 * n1y) / det, (n1x * c2 - n2x * c1) / det
            s1 = (x - p[0]) * p[2] + (y - p[1]) * p[3]
            s2 = (x - q[0]) * q[2] + (y - q[1]) * q[3]
            v1, v2 = p[4] * (1 / p[5] + s1 * s1 / p[6]), q[4] * (1 / q[5] + s2 * s2 / q[6])
            # pixel whose ray is (x, y), by Newton on the table
            u, v = corners[e, 0], corners[e, 1]
            jdet = 1.0
            for _ in range(4):
                if not _ray(rays, u, v, ray):
                    return False
                ex, ey = x - ray[0], y - ray[1]
                jdet = ray[2] * ray[5] - ray[3] * ray[4]
                u += (ray[5] * ex - ray[3] * ey) / jdet
                v += (ray[2] * ey - ray[4] * ex) / jdet
            if np.hypot(u - first[e, 0], v - first[e, 1]) > max(1.5, 1.2 * cell):
                return False
            corners[e, 0], corners[e, 1] = u, v
            # d pixel / d (c1, c2) = (d ray / d pixel)^-1 N^-1
            a00, a10 = n2y / det, -n2x / det
            a01, a11 = -n1y / det, n1x / det
            g00, g10 = (ray[5] * a00 - ray[3] * a10) / jdet, (ray[2] * a10 - ray[4] * a00) / jdet
            g01, g11 = (ray[5] * a01 - ray[3] * a11) / jdet, (ray[2] * a11 - ray[4] * a01) / jdet
            cov[e, 0, 0] = g00 * g00 * v1 + g01 * g01 * v2
            cov[e, 1, 1] = g10 * g10 * v1 + g11 * g11 * v2
            cov[e, 0, 1] = g00 * g10 * v1 + g01 * g11 * v2
            cov[e, 1, 0] = cov[e, 0, 1]
    return True
