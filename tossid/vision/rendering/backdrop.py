"""The scene behind the object: the ground, its texture, and prints on it that resemble tags."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from tossid.vision.cameras.camera import Camera
from tossid.vision.rendering._ground_texture import Items, Levels, paint_ground
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


def backdrop(
    cam: Camera,
    *,
    levels: tuple[float, float, float, float],
    light: float,
    lens: tuple[float, float],
    samples: Array,
    texture: float,
    litter: tuple[Litter, ...],
) -> Image:
    """The empty scene as a camera sees it, before the lens's blur: a ground that fades with distance, a dim wall.

    Args:
        cam: The camera.
        levels: Grey levels of ground, wall, white and black prints at full light.
        light: Light on the ground, as a share of full light.
        lens: Radius of its aperture and distance in focus [m].
        samples: (s, 5) lattice, as `_raster.cast` has it.
        texture: Contrast of the ground's pattern [grey levels].
        litter: Prints that lie on the ground.

    Returns:
        (height, width) grey levels.
    """
    width, height = cam.resolution
    ground, wall, white, black = levels
    if texture == 0 and not litter and lens[0] == 0:
        return _plain(cam, ground * light, wall)
    canvas = np.empty((height, width), dtype=np.float32)
    items = np.array([[*o.at, np.cos(o.turn), np.sin(o.turn), 0.5 * o.size] for o in litter], dtype=float)
    bitmaps = np.zeros((len(litter), CELLS, CELLS), dtype=np.uint8)
    for k, thing in enumerate(litter):
        bitmaps[k, : len(thing.bitmap), : len(thing.bitmap)] = thing.bitmap
    things = Items(items.reshape(-1, 5), np.array([len(thing.bitmap) for thing in litter], dtype=np.int64), bitmaps)
    grey = Levels(ground * light, wall, texture, white * light, black * light)
    paint_ground(canvas, cam.rays, samples, np.ascontiguousarray(cam.T_world_cam), lens, grey, things)
    return canvas


def _plain(cam: Camera, ground: float, wall: float) -> Image:
    width, height = cam.resolution
    u, v = np.meshgrid(np.arange(width, dtype=float), np.arange(height, dtype=float))
    xy = cam.undistort(np.stack([u, v], axis=-1))
    rays = np.concatenate([np.nan_to_num(xy), np.ones((height, width, 1))], axis=-1) @ cam.T_world_cam[:3, :3].T
    eye = cam.T_world_cam[:3, 3]
    down = rays[..., 2] < -1e-6
    reach = np.where(down, -eye[2] / np.where(down, rays[..., 2], -1.0), 0.0)
    spot = eye[:2] + reach[..., None] * rays[..., :2]
    grain = 3.0 * np.sin(7.0 * spot[..., 0] + 1.3) * np.sin(6.0 * spot[..., 1])  # a floor is never quite even
    return np.where(down, ground / (1 + 0.05 * np.sum(spot**2, axis=-1)) + grain, wall).astype(np.float32)
