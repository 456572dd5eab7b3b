"""Short films, drawn with OpenCV: a toss beside its prediction, and an unknown object that takes shape over tosses."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from pathlib import Path

import cv2
import numpy as np
from matplotlib.colors import to_rgb
from numpy.typing import NDArray
from PIL import Image

from tossid.errors import InputError
from tossid.evaluation.figures.geometry import UNSEEN
from tossid.evaluation.figures.style import GRID, INK, LOOKS, MUTED, look
from tossid.evaluation.figures.wireframe import View, Wireframe, posed, view_from, wireframe, wireframes
from tossid.objects import ObjectModel, corner_heights, corner_positions
from tossid.objects.half_spaces import different, half_spaces, hull_in_box
from tossid.objects.polytope import CONTACT_GAP
from tossid.types import Rollout, Toss

Array = NDArray[np.float64]
Frames = NDArray[np.uint8]
Place = Callable[[Array], NDArray[np.int32]]
"""From points (..., 3) [m] to OpenCV's fixed-point pixels (..., 2)."""

FRACTION = 4
"""Fractional bits of OpenCV's coordinates."""
WIDTH, HEIGHT = 480, 360
"""Size of a film [px]."""
STRIDE = 2
"""Every so many-th frame of a toss is in its film."""
HULL_PICTURES = 24
"""Most pictures in the film of a hull over tosses."""
HULL_REACH = 1.6
"""Half the edge of what it shows, over the largest distance of a corner from the middle along an axis."""


def toss_film(toss: Toss, predicted: Rollout, model: ObjectModel, *, name: str) -> Frames:
    """A film of a toss: the measured object dark, the predicted one in its model's colour, open loop.

    Args:
        toss: The toss as measured.
        predicted: The prediction at the toss's frames.
        model: The object whose corners are drawn.
        name: The model's name, for its colour and the caption.

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
    place = _placed(view, 0.5 * (low + high), 0.88 * min(np.array([WIDTH, HEIGHT]) / (high - low)))
    ground = _picture()
    _draw_ground(ground, place, both)
    edges = wireframes(model)
    frames = []
    for k in range(0, len(toss), STRIDE):
        image = ground.copy()
        for q, color in ((toss.q[k], INK), (predicted.q[k], look(name).color)):
            _draw_bodies(image, place, view, posed(model, q), edges, rgb(color))
        _caption(image, f"{toss.t[k] - toss.t[0]:.2f} s   dark: measured   colour: {name}")
        frames.append(image)
    return np.stack(frames)


def hull_film(tosses: Sequence[Toss], learned: ObjectModel) -> Frames:
    """A film of the hull of a rigid body over tosses: grey where the object may still be, coloured what was learned.

    No point of the object is below the ground in any frame, so that each toss cuts from the space where it may be. A
    corner that has come down to the ground is a dot, one that has not is a cross.

    Args:
        tosses: In the order in which they are added, over the ground z = 0.
        learned: The object that was learned from all of them, of one body.

    Returns:
        Frames (n, h, w, 3), RGB. The view turns once.

    Raises:
        InputError: There is no toss, or the object has joints.
    """
    if not tosses or learned.n_joints:
        raise InputError("a film of the hull needs tosses of one rigid body")
    corners = learned.drawn.corner_pos
    inside = corners.mean(axis=0)
    reach = HULL_REACH * float(np.abs(corners - inside).max())
    cuts = half_spaces(tosses)
    cuts = cuts.chosen(different(cuts))
    down = np.array([corner_heights(learned.drawn, toss.q).min(axis=0) < CONTACT_GAP for toss in tosses])
    counts = np.unique(np.geomspace(1, len(tosses), HULL_PICTURES).round().astype(int))
    upright, color = np.array([1.0, 0.0, 0.0, 0.0]), rgb(LOOKS["learned"].color)
    frames = []
    for k, count in enumerate(counts.tolist()):
        view = view_from(np.deg2rad(-60) + 2 * np.pi * k / len(counts), np.deg2rad(20))
        place = _placed(view, view(inside), 0.45 * min(WIDTH, HEIGHT) / reach)
        image = _picture()
        left = hull_in_box(cuts.chosen(cuts.toss < count), inside - reach, inside + reach)
        for points, shade in ((left, rgb(MUTED)), (corners, color)):
            _draw_bodies(image, place, view, [(points, upright)], [wireframe(points)], shade)
        for pixel, seen in zip(place(corners), np.atleast_1d(down[:count].any(axis=0)), strict=True):
            if seen:
                cv2.circle(image, pixel.tolist(), 3 * 2**FRACTION, color, -1, cv2.LINE_AA, FRACTION)
            else:
                x, y = (pixel / 2**FRACTION).round().astype(int).tolist()
                cv2.drawMarker(image, (x, y), rgb(UNSEEN), cv2.MARKER_TILTED_CROSS, 8, 2, cv2.LINE_AA)
        plural = "" if count == 1 else "es"
        _caption(image, f"{count} toss{plural}   grey: where it may be   colour: learned")
        frames.append(image)
    return np.stack(frames)


def save_film(film: Frames, path: Path, *, frame_ms: int) -> Path:
    """Write frames (n, h, w, 3), RGB, as an animated GIF in which each stays for some time [ms]; returns its path."""
    frames = [Image.fromarray(frame) for frame in film]
    frames[0].save(path, format="GIF", save_all=True, append_images=frames[1:], duration=frame_ms, loop=0)
    return path


def rgb(color: str) -> tuple[int, int, int]:
    """Red, green and blue of any of matplotlib's colours, 0 to 255 each."""
    r, g, b = (round(255 * part) for part in to_rgb(color))
    return r, g, b


def _picture() -> Frames:
    return np.full((HEIGHT, WIDTH, 3), 255, dtype=np.uint8)


def _placed(view: View, middle: Array, scale: float) -> Place:
    """Points to pixels, so many a metre, with a place (2,) of the view in the middle of the picture."""

    def place(points: Array) -> NDArray[np.int32]:
        pixel = (view(points) - middle) * [scale, -scale] + 0.5 * np.array([WIDTH, HEIGHT])
        return np.asarray(np.round(pixel * 2**FRACTION), dtype=np.int32)

    return place


def _caption(image: Frames, text: str) -> None:
    cv2.putText(image, text, (10, 20), cv2.FONT_HERSHEY_SIMPLEX, 0.42, rgb(INK), 1, cv2.LINE_AA)


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


def _draw_bodies(
    image: Frames,
    place: Place,
    view: View,
    bodies: Iterable[tuple[Array, Array]],
    edges: Iterable[Wireframe],
    color: tuple[int, ...],
) -> None:
    """Each body's edges into the image, those on the far side thin; bodies are as `posed` has them."""
    for (corners, quat), wires in zip(bodies, edges, strict=True):
        pixel, near = place(corners), wires.visible(quat, view.toward)
        for (i, j), front in sorted(zip(wires.edges.tolist(), near.tolist(), strict=True), key=lambda each: each[1]):
            cv2.line(image, pixel[i].tolist(), pixel[j].tolist(), color, 2 if front else 1, cv2.LINE_AA, FRACTION)
