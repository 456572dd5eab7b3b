"""The renderer's inner loop: distributed ray casting of flat faces (Numba)."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

Array = NDArray[np.float64]


@njit(cache=True, nogil=True, error_model="numpy")
def cast(
    canvas: NDArray[np.float32],
    x0: int,
    y0: int,
    rays: Array,
    samples: Array,
    seed: int,
    planes: Array,
    front: NDArray[np.bool_],
    edges: Array,
    n_edges: NDArray[np.int64],
    shade: Array,
    face_tags: NDArray[np.int64],
    tag_map: Array,
    bitmaps: NDArray[np.uint8],
    white: float,
    black: float,
) -> None:
    """Blend the faces over a canvas in place.

    Each pixel averages rays over its area and the exposure: a fixed lattice in
    (x, y, time), shifted for each pixel by a hash so that no edge direction is
    favoured (Cook, Porter, Carpenter 1984: distributed ray tracing).

    Args:
        canvas: (h, w) grey levels of the region whose first pixel is (x0, y0).
        rays: (H + 1, W + 1, 2) normalised coordinates at pixel corners (`Camera.rays`).
        samples: (s, 3) lattice in [0, 1).
        planes: (t, f, 12) at each sub-exposure, camera frame: normal and n·P, then the two in-plane axes,
            each with its dot product with the face's centre P.
        front: (t, f) whether the face looks at the camera.
        edges: (t, f, k, 3) planes through the eye and each of the first `n_edges[f]` edges, positive outside.
        shade: (f,) brightness factor.
        face_tags: (f, 2) first tag and number of tags of each face.
        tag_map: (m, 2, 3) from (u, v, 1) to cells (column, row from the top).
        bitmaps: (m, 8, 8) of 0 black, 1 white.
        white, black: grey levels of white paper and black ink at shade 1.
    """
    height, width = canvas.shape
    n_samples, n_times, n_faces = samples.shape[0], planes.shape[0], planes.shape[1]
    cells = bitmaps.shape[1]
    for row in range(height):
        for column in range(width):
            gx, gy = x0 + column, y0 + row
            h = np.uint32(gx) * np.uint32(73856093) ^ np.uint32(gy) * np.uint32(19349663) ^ np.uint32(seed)
            h = (h ^ (h >> np.uint32(16))) * np.uint32(0x45D9F3B)
            h = (h ^ (h >> np.uint32(16))) * np.uint32(0x45D9F3B)
            h = h ^ (h >> np.uint32(16))
            shift_x = (h & np.uint32(1023)) / 1024.0
            shift_y = ((h >> np.uint32(10)) & np.uint32(1023)) / 1024.0
            shift_t = ((h >> np.uint32(20)) & np.uint32(1023)) / 1024.0
            ax, ay = rays[gy, gx, 0], rays[gy, gx, 1]
            bx, by = rays[gy, gx + 1, 0] - ax, rays[gy, gx + 1, 1] - ay
            cx, cy = rays[gy + 1, gx, 0] - ax, rays[gy + 1, gx, 1] - ay
            dx, dy = rays[gy + 1, gx + 1, 0] - ax - bx - cx, rays[gy + 1, gx + 1, 1] - ay - by - cy
            behind = float(canvas[row, column])
            total = 0.0
            for s in range(n_samples):
                fx = samples[s, 0] + shift_x
                if fx >= 1.0:
                    fx -= 1.0
                fy = samples[s, 1] + shift_y
                if fy >= 1.0:
                    fy -= 1.0
                ft = samples[s, 2] + shift_t
                if ft >= 1.0:
                    ft -= 1.0
                time = int(ft * n_times)
                x = ax + fx * bx + fy * (cx + fx * dx)
                y = ay + fx * by + fy * (cy + fx * dy)
                nearest = np.inf
                level = behind
                for f in range(n_faces):
                    if not front[time, f]:
                        continue
                    inside = True
                    for k in range(n_edges[f]):
                        if edges[time, f, k, 0] * x + edges[time, f, k, 1] * y + edges[time, f, k, 2] > 0:
                            inside = False
                            break
                    if not inside:
                        continue
                    slope = planes[time, f, 0] * x + planes[time, f, 1] * y + planes[time, f, 2]
                    if slope >= 0:
                        continue
                    z = planes[time, f, 3] / slope
                    if z >= nearest:
                        continue
                    nearest = z
                    level = white * shade[f]
                    if face_tags[f, 1] == 0:
                        continue
                    p = planes[time, f]
                    u = z * (p[4] * x + p[5] * y + p[6]) - p[7]
                    v = z * (p[8] * x + p[9] * y + p[10]) - p[11]
                    for m in range(face_tags[f, 0], face_tags[f, 0] + face_tags[f, 1]):
                        i = tag_map[m, 0, 0] * u + tag_map[m, 0, 1] * v + tag_map[m, 0, 2]
                        j = tag_map[m, 1, 0] * u + tag_map[m, 1, 1] * v + tag_map[m, 1, 2]
                        if 0 <= i < cells and 0 <= j < cells:
                            if bitmaps[m, int(j), int(i)] == 0:
                                level = black * shade[f]
                            break
                total += level
            canvas[row, column] = total / n_samples
