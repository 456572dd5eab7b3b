"""The scene behind the object (Numba): a ground that fades with distance, its texture, prints on it, and a wall."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from tossid.kernels import kernel, part_kernel
from tossid.vision.cameras.camera import Camera
from tossid.vision.setup.faces import FAMILY_SIZE, TAG_CELLS, tag_bitmap

Array = NDArray[np.float64]
Image = NDArray[np.float32]

KINDS = ("tag", "code", "other family", "chessboard", "frame", "stripes")
CELLS = TAG_CELLS + 2
"""Most cells across a thing, its white margin included."""


@dataclass(frozen=True, eq=False)
class Litter:
    """A flat square print on the ground.

    Attributes:
        kind: One of `KINDS`.
        tag_id: Of a "tag", else None.
        at: (x, y) [m].
        turn: About the vertical [rad].
        size: With its white margin [m].
        bitmap: (c, c), 0 black and 1 white.
    """

    kind: str
    tag_id: int | None
    at: tuple[float, float]
    turn: float
    size: float
    bitmap: NDArray[np.uint8]


def scatter(count: int, rng: np.random.Generator, *, area: float, own_ids: frozenset[int]) -> tuple[Litter, ...]:
    """Prints scattered over the ground, none over another: each of `KINDS` in turn.

    A "tag" is a real one of 36h11 that is not the object's. A "code" has a tag's border around cells that are no
    tag's. A "frame" has the border alone.

    Args:
        count: How many; fewer where they find no room.
        rng: Source of their kinds and places.
        area: Diameter of the disc that they lie in [m].
        own_ids: Ids of the object's tags.

    Returns:
        The prints.
    """
    things: list[Litter] = []
    strange = [tag_id for tag_id in range(FAMILY_SIZE) if tag_id not in own_ids]
    for index in range(count):
        kind = KINDS[index % len(KINDS)]
        tag_id = int(rng.choice(strange)) if kind == "tag" else None
        bitmap = np.pad(_picture(kind, tag_id, rng), 1, constant_values=1)
        size, turn = float(rng.uniform(0.05, 0.13)), float(rng.uniform(0, 2 * np.pi))
        for _ in range(200):
            far, way = 0.5 * area * np.sqrt(rng.random()), rng.uniform(0, 2 * np.pi)
            x, y = float(far * np.cos(way)), float(far * np.sin(way))
            if all(np.hypot(x - o.at[0], y - o.at[1]) > 0.72 * (size + o.size) for o in things):
                things.append(Litter(kind, tag_id, (x, y), turn, size, bitmap))
                break
    return tuple(things)


def _picture(kind: str, tag_id: int | None, rng: np.random.Generator) -> NDArray[np.uint8]:
    if tag_id is not None:
        return tag_bitmap(tag_id)
    if kind == "other family":
        family = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_25h9)
        return np.asarray(cv2.aruco.generateImageMarker(family, int(rng.integers(35)), 7) > 127, dtype=np.uint8)
    i, j = np.indices((TAG_CELLS, TAG_CELLS))
    if kind == "chessboard":
        return ((i + j) % 2).astype(np.uint8)
    if kind == "stripes":
        return np.repeat(rng.integers(0, 2, (TAG_CELLS, 1)), TAG_CELLS, axis=1).astype(np.uint8)
    inside = (np.minimum(i, j) > 0) & (np.maximum(i, j) < TAG_CELLS - 1)
    cells = rng.integers(0, 2, i.shape) if kind == "code" else np.ones(i.shape)
    return np.where(inside, cells, 0).astype(np.uint8)


class Levels(NamedTuple):
    """Grey levels of the empty scene; of the texture, about its standard deviation."""

    ground: float
    wall: float
    texture: float
    white: float
    black: float


def backdrop(
    camera: Camera, levels: Levels, *, lens: tuple[float, float], samples: Array, litter: tuple[Litter, ...] = ()
) -> Image:
    """The empty scene as a camera sees it, before the lens's blur; a pixel is the mean of rays over its area and lens.

    Args:
        camera: The camera.
        levels: Grey levels.
        lens: Radius of its aperture and distance in focus [m].
        samples: (s, 5) lattice, as `_raster.cast` has it.
        litter: Prints that lie on the ground.

    Returns:
        (height, width) grey levels.
    """
    canvas = np.empty(camera.resolution[::-1], dtype=np.float32)
    items = np.array([[*o.at, np.cos(o.turn), np.sin(o.turn), 0.5 * o.size] for o in litter], dtype=float)
    cells = np.array([len(thing.bitmap) for thing in litter], dtype=np.int64)
    bitmaps = np.zeros((len(litter), CELLS, CELLS), dtype=np.uint8)
    for bitmap, thing in zip(bitmaps, litter, strict=True):
        bitmap[: len(thing.bitmap), : len(thing.bitmap)] = thing.bitmap
    T = np.ascontiguousarray(camera.T_world_cam)
    _paint(canvas, camera.rays, samples, T, lens, levels, items.reshape(-1, 5), (cells, bitmaps))
    return canvas


@part_kernel
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


@kernel
def _paint(
    canvas: NDArray[np.float32],
    rays: Array,
    samples: Array,
    T_world_cam: Array,
    lens: tuple[float, float],
    grey: Levels,
    items: Array,
    bitmaps: tuple[NDArray[np.int64], NDArray[np.uint8]],
) -> None:
    """Fill in the canvas; items (n, 5): x, y [m], cosine and sine of its turn, half its width [m]."""
    R, eye = T_world_cam[:3, :3], T_world_cam[:3, 3]
    ground, wall, texture, white, black = grey
    cells, cell = bitmaps
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
                        level = white if cell[k, j, i] else black
                        break
                total += level
            canvas[row, column] = total / len(samples)
