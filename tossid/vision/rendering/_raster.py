"""The renderer's inner loop: distributed ray casting of flat faces (Numba)."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tossid.kernels import kernel, part_kernel

Array = NDArray[np.float64]


class Faces(NamedTuple):
    """Flat faces in a camera's frame at each of t sub-exposures.

    Attributes:
        planes: (t, f, 12): normal and n·P, then the two in-plane axes, each with its dot product with the face's
            centre P.
        front: (t, f) whether the face looks at the camera.
        edges: (t, f, k, 3) planes through the eye and each of the first `n_edges[f]` edges, positive outside.
        n_edges: (f,) edges of each face.
        boxes: (f, 4) least and greatest x and y [normalised] that each face can have.
    """

    planes: Array
    front: NDArray[np.bool_]
    edges: Array
    n_edges: NDArray[np.int64]
    boxes: Array


class Prints(NamedTuple):
    """What is on the faces.

    Attributes:
        paper: (f,) grey level of each face, as lit.
        ink: (f,) grey level of the black of its tags, as lit.
        face_tags: (f, 2) first tag and number of tags of each face.
        tag_map: (m, 2, 3) from in-plane coordinates (u, v, 1) to a tag's cells (column, row from the top).
        bitmaps: (m, 8, 8) cells of each tag, 0 black and 1 white.
    """

    paper: Array
    ink: Array
    face_tags: NDArray[np.int64]
    tag_map: Array
    bitmaps: NDArray[np.uint8]


class Optics(NamedTuple):
    """Shutter, lens and lamp.

    Attributes:
        shutter: Sub-exposures from one row of the image to the next, and those that one row's exposure lasts.
        lens: Radius of the aperture and distance in focus [m]; radius 0 for a pinhole.
        gloss: Strength of the highlight [grey levels] and its exponent (Phong 1975), on faces that carry tags.
        lamp: (3,) where the light is, camera frame [m].
    """

    shutter: tuple[float, float]
    lens: tuple[float, float]
    gloss: tuple[float, float]
    lamp: Array


@kernel
def cast(
    canvas: NDArray[np.float32],
    origin: tuple[int, int],
    rays: Array,
    samples: Array,
    seed: int,
    faces: Faces,
    prints: Prints,
    optics: Optics,
) -> None:
    """Blend the faces over a canvas in place.

    Each pixel averages rays over its area and the exposure: a fixed lattice in
    (x, y, time), shifted for each pixel by a hash so that no edge direction is
    favoured (Cook, Porter, Carpenter 1984: distributed ray tracing).

    A ray through the point o of the lens's aperture and through what (x, y) shows in focus has the points
    (o, 0) + z (x - o_x / z_f, y - o_y / z_f, 1). Faces are met there exactly.

    Args:
        canvas: (h, w) grey levels of a region of the image.
        origin: Column and row of the region's first pixel.
        rays: (H + 1, W + 1, 2) normalised coordinates at pixel corners (`Camera.rays`).
        samples: (s, 5) lattice in [0, 1): x, y, time, and two for the lens.
        seed: Of the pixels' shifts.
        faces: Where the faces are.
        prints: What is on them.
        optics: Shutter, lens and lamp.
    """
    planes, front, edges, n_edges, boxes = faces
    paper, ink, face_tags, tag_map, bitmaps = prints
    (row_rate, span), (radius, focus), gloss, lamp = optics
    n_times, n_faces = planes.shape[0], planes.shape[1]
    near, shift = np.empty(n_faces, dtype=np.int64), np.empty(5)
    for row in range(canvas.shape[0]):
        for column in range(canvas.shape[1]):
            gx, gy = origin[0] + column, origin[1] + row
            # the ray through (fx, fy) of the pixel is a + fx b + fy c + fx fy d
            ax, ay = rays[gy, gx, 0], rays[gy, gx, 1]
            bx, by = rays[gy, gx + 1, 0] - ax, rays[gy, gx + 1, 1] - ay
            cx, cy = rays[gy + 1, gx, 0] - ax, rays[gy + 1, gx, 1] - ay
            dx, dy = rays[gy + 1, gx + 1, 0] - ax - bx - cx, rays[gy + 1, gx + 1, 1] - ay - by - cy
            left, right = ax + min(0.0, bx, cx, bx + cx + dx), ax + max(0.0, bx, cx, bx + cx + dx)
            top, bottom = ay + min(0.0, by, cy, by + cy + dy), ay + max(0.0, by, cy, by + cy + dy)
            n_near = 0
            for f in range(n_faces):
                if boxes[f, 0] <= right and boxes[f, 1] >= left and boxes[f, 2] <= bottom and boxes[f, 3] >= top:
                    near[n_near] = f
                    n_near += 1
            if n_near == 0:
                continue
            _shifts(gx, gy, seed, shift)
            total = 0.0
            for s in range(len(samples)):
                fx, fy = _wrapped(samples[s, 0] + shift[0]), _wrapped(samples[s, 1] + shift[1])
                time = min(int(gy * row_rate + _wrapped(samples[s, 2] + shift[2]) * span), n_times - 1)
                x = ax + fx * bx + fy * (cx + fx * dx)
                y = ay + fx * by + fy * (cy + fx * dy)
                ox, oy = 0.0, 0.0
                if radius > 0:
                    far = radius * np.sqrt(_wrapped(samples[s, 3] + shift[3]))
                    turn = 2 * np.pi * _wrapped(samples[s, 4] + shift[4])
                    ox, oy = far * np.cos(turn), far * np.sin(turn)
                nearest, level = np.inf, float(canvas[row, column])
                for n in range(n_near):
                    f = near[n]
                    if not front[time, f]:
                        continue
                    p = planes[time, f]
                    z, xf, yf = _meet(p, edges[time, f], n_edges[f], x, y, ox, oy, focus)
                    if z >= nearest:
                        continue
                    nearest, level = z, paper[f]
                    first, count = face_tags[f]
                    if count == 0:
                        continue
                    u = z * (p[4] * xf + p[5] * yf + p[6]) - p[7]
                    v = z * (p[8] * xf + p[9] * yf + p[10]) - p[11]
                    if _is_inked(u, v, tag_map[first : first + count], bitmaps[first : first + count]):
                        level = ink[f]
                    if gloss[0] > 0:
                        level += gloss[0] * _highlight(xf, yf, z, p, lamp) ** gloss[1]
                total += level
            canvas[row, column] = total / len(samples)


@part_kernel
def _shifts(x: int, y: int, seed: int, out: Array) -> None:
    """Fill in how far a pixel's lattice is shifted in each of its five dimensions, in [0, 1): a hash of its place."""
    h = np.uint32(x) * np.uint32(73856093) ^ np.uint32(y) * np.uint32(19349663) ^ np.uint32(seed)
    h = (h ^ (h >> np.uint32(16))) * np.uint32(0x45D9F3B)
    h = (h ^ (h >> np.uint32(16))) * np.uint32(0x45D9F3B)
    h = h ^ (h >> np.uint32(16))
    for k in range(3):
        out[k] = ((h >> np.uint32(10 * k)) & np.uint32(1023)) / 1024.0
    h = (h ^ (h >> np.uint32(15))) * np.uint32(0x2C1B3C6D)
    h = h ^ (h >> np.uint32(13))
    for k in range(2):
        out[3 + k] = ((h >> np.uint32(10 * k)) & np.uint32(1023)) / 1024.0


@part_kernel
def _wrapped(value: float) -> float:
    """A value in [0, 2) brought into [0, 1)."""
    return value - 1.0 if value >= 1.0 else value


@part_kernel
def _meet(
    p: Array, edges: Array, n_edges: int, x: float, y: float, ox: float, oy: float, focus: float
) -> tuple[float, float, float]:
    """Where a ray meets a face: its depth, infinite where it does not, and the point's normalised coordinates."""
    if ox != 0.0 or oy != 0.0:
        slope = p[0] * (x - ox / focus) + p[1] * (y - oy / focus) + p[2]
        z = (p[3] - p[0] * ox - p[1] * oy) / slope if slope < 0 else -1.0
        if z <= 0:
            return np.inf, x, y
        x, y = x + ox * (1 / z - 1 / focus), y + oy * (1 / z - 1 / focus)
    for k in range(n_edges):
        if edges[k, 0] * x + edges[k, 1] * y + edges[k, 2] > 0:
            return np.inf, x, y
    slope = p[0] * x + p[1] * y + p[2]
    return (p[3] / slope if slope < 0 else np.inf), x, y


@part_kernel
def _is_inked(u: float, v: float, tag_map: Array, bitmaps: NDArray[np.uint8]) -> bool:
    """Whether a point of a face (in its plane) lies on black of one of its tags."""
    cells = bitmaps.shape[1]
    for m in range(len(tag_map)):
        i = tag_map[m, 0, 0] * u + tag_map[m, 0, 1] * v + tag_map[m, 0, 2]
        j = tag_map[m, 1, 0] * u + tag_map[m, 1, 1] * v + tag_map[m, 1, 2]
        if 0 <= i < cells and 0 <= j < cells:
            return bitmaps[m, int(j), int(i)] == 0
    return False


@part_kernel
def _highlight(x: float, y: float, z: float, plane: Array, lamp: Array) -> float:
    """Cosine between where a mirror in the plane would send the ray that sees (x, y, z), and the lamp; 0 behind."""
    slope = plane[0] * x + plane[1] * y + plane[2]
    mx, my, mz = x - 2 * slope * plane[0], y - 2 * slope * plane[1], 1 - 2 * slope * plane[2]
    lx, ly, lz = lamp[0] - z * x, lamp[1] - z * y, lamp[2] - z
    toward = mx * lx + my * ly + mz * lz
    if toward <= 0 or plane[0] * lx + plane[1] * ly + plane[2] * lz <= 0:
        return 0.0
    return toward / np.sqrt((mx * mx + my * my + mz * mz) * (lx * lx + ly * ly + lz * lz))


@kernel
def visible_shares(faces: Faces, spots: Array, face: NDArray[np.int64], shares: Array) -> None:
    """Fill in which share of each tag no other face hides. Image borders do not count.

    Args:
        faces: Where the faces are; the first time counts.
        spots: (m, s, 3) points spread over each tag, camera frame [m].
        face: (m,) face that each tag lies on.
        shares: (m,) written.
    """
    planes, front, edges, n_edges = faces.planes[0], faces.front[0], faces.edges[0], faces.n_edges
    for m in range(len(spots)):
        open_spots = 0
        if front[face[m]]:
            for s in range(spots.shape[1]):
                z = spots[m, s, 2]
                if z <= 0:
                    continue
                x, y = spots[m, s, 0] / z, spots[m, s, 1] / z
                hidden = False
                for f in range(len(front)):
                    if f != face[m] and front[f]:
                        hidden |= _meet(planes[f], edges[f], n_edges[f], x, y, 0.0, 0.0, 1.0)[0] < z - 1e-9
                open_spots += not hidden
        shares[m] = open_spots / spots.shape[1]
