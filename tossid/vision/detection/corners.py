"""Sub-pixel corners of a tag (Numba).

The four edges of the tag's border are fitted to the image as blurred steps that are straight in undistorted
coordinates, and intersected. Each corner gets the covariance that follows from the image's gradient and noise.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from tossid.kernels import REORDERED, kernel, part_kernel
from tossid.vision.cameras.camera import Camera

Array = NDArray[np.float64]

_MOST = 64
"""Stretches of an edge, at most: the size of scratch arrays."""
_N = 11
"""Parameters of a tag's image: two of each edge, black, white, width of the edges."""
CONTRAST = 12.0
"""Least difference between black border and white margin [grey levels]."""
LEAST_SIGMA = 0.007
"""Least standard deviation of a corner [px]; measured on rendered tags."""
MOST_STEPS, CONVERGED = 12, 5e-3
"""Most Gauss-Newton steps of a fit, and the largest move of an edge at which it has converged [px]."""
CORRELATION = 4.0
"""Length along an edge over which the image's errors may be correlated [px]."""
LEAST_BLUR, MOST_BLUR = 0.3, 4.0
"""Limits of the blur's standard deviation, the pixel's own area included [px]."""


def refine_corners(
    image: NDArray[np.uint8],
    camera: Camera,
    corners: Array,
    *,
    cells: int = 8,
) -> tuple[Array, Array, bool]:
    """A detector's corners, measured again to a fraction of a pixel.

    Model: across an edge the image is black + (white - black) Φ(d / w). d is a pixel's signed distance to a line that
    is straight in undistorted coordinates, w the blur. Where the next cell inside is near, its own step at one cell's
    width is added, as bright as the image is there.

    Fit: two parameters of each line, black, white and w are fitted to the pixels around all four edges at once, by
    Gauss-Newton with Huber's weights.

    Covariance: the noise is the scatter of the residuals in the direction that moves an edge. It is summed over
    stretches of length `CORRELATION`, so that noise which neighbouring pixels share counts. The covariance of the
    lines, and so of each corner, is that noise over the gradient. The bias from what lies beyond the next cell is
    added as a variance (`_bleed`).

    Args:
        image: (height, width) grey levels.
        camera: The image's camera.
        corners: (4, 2) [px], in the order bottom-left, bottom-right, top-right, top-left.
        cells: Cells across the tag, its black border included.

    Returns:
        corners (4, 2) [px], covariances (4, 2, 2) [px²], and whether it worked. Where it
        did not, the corners are as given and the covariances zero.
    """
    refined = np.array(corners, dtype=float)
    cov = np.zeros((4, 2, 2))
    if not _refine(image, camera.rays, refined, cov, cells):
        return np.asarray(corners, dtype=float), np.zeros((4, 2, 2)), False
    return refined, cov + LEAST_SIGMA**2 * np.eye(2), True


@part_kernel
def _bleed(width: float, cell: float) -> float:
    """Standard deviation of an edge's place by what lies beyond the next cells [px]; measured on rendered tags."""
    return 0.04 * width * math.exp(-0.125 * (cell / width) ** 2)


@part_kernel
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


@kernel
def grey(image: NDArray[np.uint8], x: float, y: float) -> float:
    """Bilinear grey level, of the nearest place in the image."""
    x, y = min(max(x, 0.0), image.shape[1] - 1.001), min(max(y, 0.0), image.shape[0] - 1.001)
    column, row = int(x), int(y)
    fx, fy = x - column, y - row
    above = (1 - fx) * image[row, column] + fx * image[row, column + 1]
    return float((1 - fy) * above + fy * ((1 - fx) * image[row + 1, column] + fx * image[row + 1, column + 1]))


@part_kernel
def _lines(rays: Array, corners: Array, cells: int, lines: Array) -> bool:
    """Fill in the lines through neighbouring corners (4, 7).

    Mean x, mean y, outward normal x, y, half length (all normalised), normalised units a pixel across, cell width
    across [px].
    """
    one, two = np.empty(6), np.empty(6)
    for e in range(4):
        a, b, c, d = corners[e], corners[(e + 1) % 4], corners[(e + 2) % 4], corners[(e + 3) % 4]
        length = np.hypot(b[0] - a[0], b[1] - a[1])
        if length < 8 or not _ray(rays, a[0], a[1], one) or not _ray(rays, b[0], b[1], two):
            return False
        nx, ny = -(b[1] - a[1]) / length, (b[0] - a[0]) / length
        cell = ((a[0] + b[0] - c[0] - d[0]) * nx + (a[1] + b[1] - c[1] - d[1]) * ny) / (2 * cells)
        if cell < 0.8:
            return False
        tx, ty = two[0] - one[0], two[1] - one[1]
        long = np.hypot(tx, ty)
        lines[e, 0], lines[e, 1] = 0.5 * (one[0] + two[0]), 0.5 * (one[1] + two[1])
        lines[e, 2], lines[e, 3], lines[e, 4] = -ty / long, tx / long, 0.5 * long
        ux, uy = lines[e, 2], lines[e, 3]
        lines[e, 5] = np.hypot(one[2] * ux + one[4] * uy, one[3] * ux + one[5] * uy)
        lines[e, 6] = cell
    return True


@part_kernel
def _levels(image: NDArray[np.uint8], corners: Array, lines: Array, x: Array) -> None:
    """First guess of black and white: means half a cell inside and outside the edges."""
    black, white = 0.0, 0.0
    for e in range(4):
        a, b = corners[e], corners[(e + 1) % 4]
        length = np.hypot(b[0] - a[0], b[1] - a[1])
        nx, ny = -(b[1] - a[1]) / length, (b[0] - a[0]) / length
        for k in range(8):
            share = (k + 1) / 9
            px, py = a[0] + share * (b[0] - a[0]), a[1] + share * (b[1] - a[1])
            half = 0.5 * lines[e, 6]
            black += grey(image, px - half * nx, py - half * ny) / 32
            white += grey(image, px + half * nx, py + half * ny) / 32
    x[0], x[1], x[2] = black, white, 0.8


@kernel(fastmath=REORDERED, from_python=False)
def _collect(
    image: NDArray[np.uint8],
    rays: Array,
    corners: Array,
    lines: Array,
    e: int,
    x: Array,
    spread: float,
    H: Array,
    b: Array,
    score: Array,
) -> tuple[int, float]:
    """Add an edge's pixels to the normal equations H (11, 11), b (11,).

    x: black, white, width. spread: standard deviation of a residual that is no outlier. score: (stretches, 2)
    Σ gradient residual and Σ gradient² of each, weighted.

    Returns: number of pixels, sum of absolute residuals; -1 where the strip leaves the image.
    """
    black, white, width = x
    step = white - black
    ax, ay = corners[e]
    bx, by = corners[(e + 1) % 4]
    length = np.hypot(bx - ax, by - ay)
    tx, ty = (bx - ax) / length, (by - ay) / length
    cell = lines[e, 6]
    reach = 3 * width + 0.7
    inside, outside = min(reach, 0.75 * cell), min(reach, max(0.6 * cell, cell - 2 * width))
    start = min(2 * width, 0.2 * length)
    mx, my, nx, ny, half, unit = lines[e, 0], lines[e, 1], lines[e, 2], lines[e, 3], lines[e, 4], lines[e, 5]
    inner = cell < reach + 3 * width
    height, columns = image.shape
    n, total = 0, 0.0
    J, own_H, own_b = np.empty(5), np.zeros((5, 5)), np.zeros(5)
    # pixels column by column (row by row) along the edge's longer direction
    steep = abs(by - ay) > abs(bx - ax)
    p0, p1 = (ay, by) if steep else (ax, bx)
    q0, slope = (ax, (bx - ax) / (by - ay)) if steep else (ay, (by - ay) / (bx - ax))
    wide = max(inside, outside) * np.sqrt(1 + slope * slope) + 1
    for p in range(int(np.ceil(min(p0, p1))), int(np.floor(max(p0, p1))) + 1):
        middle = q0 + (p - p0) * slope
        for q in range(int(np.ceil(middle - wide)), int(np.floor(middle + wide)) + 1):
            u, v = (q, p) if steep else (p, q)
            along = (u - ax) * tx + (v - ay) * ty
            if along < start or along > length - start:
                continue
            across = -(u - ax) * ty + (v - ay) * tx
            if across < -inside - 1 or across > outside + 1:
                continue
            if u < 0 or v < 0 or u >= columns or v >= height:
                return -1, 0.0
            a0, a1, b0, b1 = rays[v, u, 0], rays[v, u, 1], rays[v, u + 1, 0], rays[v, u + 1, 1]
            c0, c1, d0, d1 = rays[v + 1, u, 0], rays[v + 1, u, 1], rays[v + 1, u + 1, 0], rays[v + 1, u + 1, 1]
            rx, ry = 0.25 * (a0 + b0 + c0 + d0) - mx, 0.25 * (a1 + b1 + c1 + d1) - my
            jx = 0.5 * ((b0 + d0 - a0 - c0) * nx + (b1 + d1 - a1 - c1) * ny)
            jy = 0.5 * ((c0 + d0 - a0 - b0) * nx + (c1 + d1 - a1 - b1) * ny)
            here = math.sqrt(jx * jx + jy * jy)
            d = (rx * nx + ry * ny) / here
            if not -inside <= d <= outside:
                continue
            z = d / width
            share = 0.5 * math.erfc(-z * 0.7071067811865476)
            bell = 0.3989422804014327 * math.exp(-0.5 * z * z) / width
            model, slant, even = black + step * share, step * bell, -step * bell * z
            if inner:
                level = grey(image, u + (d + 1.5 * cell) * ty, v - (d + 1.5 * cell) * tx) - black
                zi = (-cell - d) / width
                bell_in = 0.3989422804014327 * math.exp(-0.5 * zi * zi) / width
                model += level * 0.5 * math.erfc(-zi * 0.7071067811865476)
                slant -= level * bell_in
                even -= level * bell_in * zi
            r = image[v, u] - model
            weight = min(1.0, 2.5 * spread / max(abs(r), 1e-9))
            g = -slant * unit / here
            s = (rx * ny - ry * nx) / half
            J[0], J[1], J[2], J[3], J[4] = g, g * s, 1 - share, share, even
            for k in range(5):
                weighted = weight * J[k]
                own_b[k] += weighted * r
                for m in range(k + 1):
                    own_H[k, m] += weighted * J[m]
            bin_ = min(int(along / CORRELATION), _MOST - 1)
            score[bin_, 0] += weight * g * r
            score[bin_, 1] += weight * g * g
            n += 1
            total += abs(r)
    for k in range(5):
        row = 2 * e + k if k < 2 else 6 + k
        b[row] += own_b[k]
        for m in range(k + 1):
            column = 2 * e + m if m < 2 else 6 + m
            H[row, column] += own_H[k, m]
            if m < k:
                H[column, row] += own_H[k, m]
    return n, total


@part_kernel
def _corners(rays: Array, lines: Array, move: Array, corners: Array, cov: Array, C: Array, bleed2: Array) -> bool:
    """Move the lines (8 offsets at middle and end [px]), intersect them, and propagate the covariance C (8, 8)."""
    ray = np.empty(6)
    G, D = np.empty((2, 2)), np.zeros((2, 4))
    part = np.empty((4, 4))
    n, c = np.empty((4, 2)), np.empty(4)
    for e in range(4):
        nx, ny, half, unit = lines[e, 2], lines[e, 3], lines[e, 4], lines[e, 5]
        # points of the moved line: m + unit (a + b s) n + half s t, at s = 0 and 1
        a, b = unit * move[2 * e], unit * move[2 * e + 1]
        tx, ty = half * ny + b * nx, -half * nx + b * ny
        long = np.hypot(tx, ty)
        n[e, 0], n[e, 1] = -ty / long, tx / long
        c[e] = n[e, 0] * (lines[e, 0] + a * nx) + n[e, 1] * (lines[e, 1] + a * ny)
    for e in range(4):
        f = (e + 3) % 4
        det = n[f, 0] * n[e, 1] - n[f, 1] * n[e, 0]
        if abs(det) < 0.05:
            return False
        x, y = (c[f] * n[e, 1] - c[e] * n[f, 1]) / det, (n[f, 0] * c[e] - n[e, 0] * c[f]) / det
        u, v = corners[e, 0], corners[e, 1]
        jdet = 1.0
        for _ in range(4):  # pixel whose ray is (x, y), by Newton on the table
            if not _ray(rays, u, v, ray):
                return False
            ex, ey = x - ray[0], y - ray[1]
            jdet = ray[2] * ray[5] - ray[3] * ray[4]
            u += (ray[5] * ex - ray[3] * ey) / jdet
            v += (ray[2] * ey - ray[4] * ex) / jdet
        corners[e, 0], corners[e, 1] = u, v
        # d pixel / d (offsets of the two lines at the corner)
        n00, n10, n01, n11 = n[e, 1] / det, -n[e, 0] / det, -n[f, 1] / det, n[f, 0] / det
        G[0, 0], G[1, 0] = (ray[5] * n00 - ray[3] * n10) / jdet, (ray[2] * n10 - ray[4] * n00) / jdet
        G[0, 1], G[1, 1] = (ray[5] * n01 - ray[3] * n11) / jdet, (ray[2] * n11 - ray[4] * n01) / jdet
        for k in range(2):
            o = (f, e)[k]
            s = ((x - lines[o, 0]) * lines[o, 3] - (y - lines[o, 1]) * lines[o, 2]) / lines[o, 4]
            D[k, 2 * k], D[k, 2 * k + 1] = lines[o, 5], lines[o, 5] * s
            for m in range(2):
                i = (f, e)[m]
                part[2 * k : 2 * k + 2, 2 * m : 2 * m + 2] = C[2 * o : 2 * o + 2, 2 * i : 2 * i + 2]
        S = D @ part @ D.T
        S[0, 0] += bleed2[f] * lines[f, 5] ** 2
        S[1, 1] += bleed2[e] * lines[e, 5] ** 2
        cov[e, :, :] = G @ S @ G.T
    return True


@kernel
def _refine(image: NDArray[np.uint8], rays: Array, corners: Array, cov: Array, cells: int) -> bool:
    """Refine corners (4, 2) in place; fill cov (4, 2, 2)."""
    first = corners.copy()
    lines, x = np.empty((4, 7)), np.zeros(3)
    C, bleed2 = np.zeros((8, 8)), np.zeros(4)
    spread = 1e9
    for attempt in range(MOST_STEPS):
        if not _lines(rays, corners, cells, lines):
            return False
        if attempt == 0:
            _levels(image, corners, lines, x)
        if not x[1] - x[0] > 0.5 * CONTRAST:
            return False
        H, b = np.zeros((_N, _N)), np.zeros(_N)
        score = np.zeros((4 * _MOST, 2))
        n, total = 0, 0.0
        for e in range(4):
            own = score[e * _MOST : (e + 1) * _MOST]
            count, size = _collect(image, rays, corners, lines, e, x, spread, H, b, own)
            if count < 8:
                return False
            n, total = n + count, total + size
        if n < 2 * _N:
            return False
        spread = max(1.2533 * total / n, 1.0)
        for k in range(10):
            H[k, k] += 1e-3  # so little that it only keeps what is no tag from being singular
        # what blur to expect is known a little
        H[10, 10] += spread * spread / 0.25
        b[10] += spread * spread / 0.25 * (0.8 - x[2])
        inverse = np.linalg.inv(H)
        step = inverse @ b
        most = np.abs(step[:8]).max()
        if not most < 1e3:
            return False
        limit = min(1.0, 1.0 / max(most, 1e-12))
        x[0] += limit * step[8]
        x[1] += limit * step[9]
        x[2] = min(max(x[2] + limit * min(max(step[10], -0.4), 0.4), LEAST_BLUR), MOST_BLUR)
        done = most < CONVERGED or attempt == MOST_STEPS - 1
        if done:
            if x[1] - x[0] < CONTRAST:
                return False
            squares, noise, bins = 0.0, 0.0, 0
            for k in range(4 * _MOST):
                if score[k, 1] > 0:
                    squares += score[k, 0] ** 2
                    noise += score[k, 1]
                    bins += 1
            variance = squares / noise * bins / max(bins - 10, 4)
            C[:, :] = variance * inverse[:8, :8]
            for e in range(4):
                bleed2[e] = _bleed(x[2], lines[e, 6]) ** 2
        if not _corners(rays, lines, limit * step[:8], corners, cov, C, bleed2):
            return False
        for e in range(4):
            if np.hypot(corners[e, 0] - first[e, 0], corners[e, 1] - first[e, 1]) > max(1.5, 1.2 * lines[e, 6]):
                return False
        if done:
            return True
    return False
