"""A toss as a short film: measured and predicted wireframes over the ground, drawn with OpenCV."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
from matplotlib.colors import to_rgb
from numpy.typing import NDArray
from PIL import Image

from tossid.errors import InputError
from tossid.evaluation.figures.style import GRID, INK, look
from tossid.evaluation.figures.wireframe import View, posed, view_from, wireframe
from tossid.objects import ObjectModel, corner_positions
from tossid.settings.figures import FigureSettings
from tossid.types import Rollout, Toss

Array = NDArray[np.float64]
Frames = NDArray[np.uint8]

Place = Callable[[Array], NDArray[np.int32]]
"""From points (..., 3) [m] to OpenCV's fixed-point pixels (..., 2)."""

FRACTION = 4
"""Fractional bits of OpenCV's coordinates."""


def toss_film(
    toss: Toss, predicted: Rollout, model: ObjectModel, *, name: str, settings: FigureSettings = FigureSettings()
) -> Frames:
    """A film of a toss: the measured object dark, the predicted one in its model's colour, open loop.

    Args:
        toss: The toss as measured.
        predicted: The prediction at the toss's frames.
        model: The object whose corners are drawn.
        name: The model's name, for its colour and the caption.
        settings: The film's size and stride.

    Returns:
        Frames (n, h, w, 3), RGB.

    Raises:
        InputError: The motions have different lengths.
    """
    if predicted.q.shape != toss.q.shape:
        raise InputError(f"{toss.name}: predicted {predicted.q.shape}, the toss has {toss.q.shape}")
    view = view_from(np.deg2rad(-60), np.deg2rad(20))
    both = np.concatenate([corner_positions(model, q) for q in (toss.q, predicted.q)]).reshape(-1, 3)
    flat = view(np.concatenate([both, both * [1, 1, 0]]))
    low, high = flat.min(axis=0), flat.max(axis=0)
    width, height = settings.film_size
    scale = 0.88 * min(np.array(settings.film_size) / (high - low))
    middle = 0.5 * (low + high)
    colors = {"measured": rgb(INK), "predicted": rgb(look(name).color)}

    def place(points: Array) -> NDArray[np.int32]:
        pixel = (view(points) - middle) * [scale, -scale] + 0.5 * np.array(settings.film_size)
        return np.round(pixel * 2**FRACTION).astype(np.int32)

    ground = np.full((height, width, 3), 255, dtype=np.uint8)
    _draw_ground(ground, place, both)
    drawn = model.drawn
    edges = [wireframe(drawn.corner_pos[drawn.corner_body == b]) for b in range(model.n_bodies)]
    frames = []
    for k in range(0, len(toss), settings.film_stride):
        image = ground.copy()
        for which, q in (("measured", toss.q[k]), ("predicted", predicted.q[k])):
            draw_bodies(image, place, view, posed(model, q), edges, colors[which])
        words = f"{toss.t[k] - toss.t[0]:.2f} s   dark: measured   colour: {name}"
        cv2.putText(image, words, (10, 20), cv2.FONT_HERSHEY_SIMPLEX, 0.42, rgb(INK), 1, cv2.LINE_AA)
        frames.append(image)
    return np.stack(frames)


def save_film(film: Frames, path: Path, *, frame_ms: int) -> Path:
    """Write a film as an animated GIF.

    Args:
        film: Frames (n, h, w, 3), RGB.
        path: The file.
        frame_ms: How long a frame stays [ms].

    Returns:
        The file.
    """
    frames = [Image.fromarray(frame) for frame in film]
    frames[0].save(path, format="GIF", save_all=True, append_images=frames[1:], duration=frame_ms, loop=0)
    return path


def _draw_ground(image: Frames, place: Place, points: Array) -> None:
    """A grid of 10 cm on z = 0 below the points."""
    low, high = np.floor(points.min(axis=0) * 10) / 10, np.ceil(points.max(axis=0) * 10) / 10
    for axis in (0, 1):
        for at in np.arange(low[axis], high[axis] + 1e-9, 0.1):
            line = np.zeros((2, 3))
            line[:, axis] = at
            line[:, 1 - axis] = low[1 - axis], high[1 - axis]
            a, b = place(line)
            cv2.line(image, a.tolist(), b.tolist(), rgb(GRID), 1, cv2.LINE_AA, FRACTION)


def draw_bodies(
    image: Frames, place: Place, view: View, bodies: list[tuple[Array, Array]], edges: list, color: tuple[int, ...]
) -> None:  # fmt: skip
    """Draw each body's edges; those on the far side thin.

    Args:
        image: Drawn into.
        place: From points to pixels.
        view: Who looks.
        bodies: Corners (n, 3) [m] and orientation (4,) of each, as `posed` has them.
        edges: Of each its `Wireframe`.
        color: RGB.
    """
    for (corners, quat), wires in zip(bodies, edges, strict=True):
        pixel, near = place(corners), wires.visible(quat, view.toward)
        for (i, j), front in sorted(zip(wires.edges.tolist(), near.tolist(), strict=True), key=lambda each: each[1]):
            cv2.line(image, pixel[i].tolist(), pixel[j].tolist(), color, 2 if front else 1, cv2.LINE_AA, FRACTION)


def rgb(color: str) -> tuple[int, int, int]:
    """A colour's red, green and blue.

    Args:
        color: Any of matplotlib's.
    """
    r, g, b = (round(255 * part) for part in to_rgb(color))
    return r, g, b
