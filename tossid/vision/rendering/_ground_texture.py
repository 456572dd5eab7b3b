"""The ground under the object, with its texture and what lies on it, sampled pixel by pixel (Numba)."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tossid.kernels import kernel

Array = NDArray[np.float64]


@kernel
def _noise(x: float, y: float) -> float:
    """Smooth noise in [-1, 1] with features of size 1: hashed values at whole numbers, blended between."""
    fx, fy = np.floor(x), np.floor(y)
    ux, uy = x - fx, y - fy
    ux, uy = ux * ux * (3 - 2 * ux), uy * uy * (3 - 2 * uy)
    total = 0.0
    for i in range(2):
        for j in range(2):
            h = np.uint32(np.int64(fx) + i + 100000) * np.uint32(73856093)
            h = h ^ np.uint32(np.int64(fy) + j + 100000) * np.uint32(19349663)
            h = (h ^ (h >> np.uint32(16))) * np.uint32(0x45D9F3B)
            h = h ^ (h >> np.uint32(16))
            weight = (ux if i else 1 - ux) * (uy if j else 1 - uy)
            total += weight * ((h & np.uint32(65535)) / 32767.5 - 1.0)
    return total


class Levels(NamedTuple):
    """Grey levels of the empty scene; of the texture, about its standard deviation."""

    ground: float
    wall: float
    texture: float
    white: float
    black: float


class Items(NamedTuple):
    """Flat square prints on the ground.

    Attributes:
        places: (n, 5) x, y [m], cosine and sine of its turn, half its width [m].
        cells: (n,) cells across each.
        bitmaps: (n, c, c), 0 black and 1 white; the first row is at the top.
    """

    places: Array
    cells: NDArray[np.int64]
    bitmaps: NDArray[np.uint8]


@kernel
def paint_ground(
    canvas: NDArray[np.float32],
    rays: Array,
    samples: Array,
    T_world_cam: Array,
    lens: tuple[float, float],
    grey: Levels,
    things: Items,
) -> None:
    """The empty scene, each pixel the mean of rays over its area and the lens's aperture.

    Args:
        canvas: (H, W) written.
        rays: (H + 1, W + 1, 2) normalised coordinates at pixel corners (`Camera.rays`).
        samples: (s, 5) lattice, as `_raster.cast` has it.
        T_world_cam: (4, 4) pose of the camera.
        lens: Radius of the aperture and distance in focus [m].
        grey: Grey levels.
        things: What lies on the ground.
    """
    R, eye = T_world_cam[:3, :3], T_world_cam[:3, 3]
    ground, wall, texture, white, black = grey
    items, cells, bitmaps = things
    height, width = canvas.shape
    radius, focus = lens
    for row in range(height):
        for column in range(width):
            ax, ay = rays[row, column, 0], rays[row, column, 1]
            bx, by = rays[row, column + 1, 0] - ax, rays[row, column + 1, 1] - ay
            cx, cy = rays[row + 1, column, 0] - ax, rays[row + 1, column, 1] - ay
            total = 0.0
            for s in range(len(samples)):
                x = ax + samples[s, 0] * bx + samples[s, 1] * cx
                y = ay + samples[s, 0] * by + samples[s, 1] * cy
                far = radius * np.sqrt(samples[s, 3])
                ox, oy = far * np.cos(2 * np.pi * samples[s, 4]), far * np.sin(2 * np.pi * samples[s, 4])
                dx, dy = x - ox / focus, y - oy / focus
                down = R[2, 0] * dx + R[2, 1] * dy + R[2, 2]
                if not down < -1e-6:
                    total += wall
                    continue
                z = -(eye[2] + R[2, 0] * ox + R[2, 1] * oy) / down
                px = eye[0] + R[0, 0] * (ox + z * dx) + R[0, 1] * (oy + z * dy) + R[0, 2] * z
                py = eye[1] + R[1, 0] * (ox + z * dx) + R[1, 1] * (oy + z * dy) + R[1, 2] * z
                level = ground / (1 + 0.05 * (px * px + py * py)) + 3.0 * np.sin(7.0 * px + 1.3) * np.sin(6.0 * py)
                if texture > 0:
                    grain = _noise(px / 0.15, py / 0.15) + _noise(px / 0.04, py / 0.04) + _noise(px / 0.01, py / 0.01)
                    level += texture * grain
                for k in range(len(items)):
                    tx, ty = px - items[k, 0], py - items[k, 1]
                    u = (items[k, 2] * tx + items[k, 3] * ty) / items[k, 4]
                    v = (items[k, 2] * ty - items[k, 3] * tx) / items[k, 4]
                    if -1 < u < 1 and -1 < v < 1:
                        i, j = int(0.5 * (u + 1) * cells[k]), int(0.5 * (1 - v) * cells[k])
                        level = white if bitmaps[k, j, i] else black
                        break
                total += level
            canvas[row, column] = total / len(samples)
