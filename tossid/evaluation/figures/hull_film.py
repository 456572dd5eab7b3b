"""A film of an unknown object that takes shape: what is left of space after ever more tosses."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from tossid.errors import InputError
from tossid.evaluation.figures.film import FRACTION, Frames, Place, draw_bodies, rgb
from tossid.evaluation.figures.geometry import UNSEEN
from tossid.evaluation.figures.style import INK, LOOKS, MUTED
from tossid.evaluation.figures.wireframe import View, view_from, wireframe
from tossid.objects import ObjectModel, corner_heights
from tossid.objects.half_spaces import different, half_spaces, hull_within
from tossid.settings.figures import FigureSettings
from tossid.settings.objects import ShapeSettings
from tossid.types import Toss

Array = NDArray[np.float64]
_UPRIGHT = np.array([1.0, 0.0, 0.0, 0.0])


def hull_film(
    tosses: Sequence[Toss],
    learned: ObjectModel,
    *,
    settings: FigureSettings = FigureSettings(),
    shape: ShapeSettings = ShapeSettings(),
) -> Frames:
    """A film of the hull of a rigid body over tosses: grey where the object may still be, coloured what was learned.

    No point of the object is below the ground in any frame, so that each toss cuts from the space where it may be. A
    corner that has come down to the ground is a dot, one that has not is a cross.

    Args:
        tosses: In the order in which they are added, over the ground z = 0.
        learned: The object that was learned from all of them, of one body.
        settings: The film's size, and how many pictures it has.
        shape: How near the ground a contact is.

    Returns:
        Frames (n, h, w, 3), RGB. The view turns once.

    Raises:
        InputError: There is no toss, or the object has joints.
    """
    if not tosses or learned.n_joints:
        raise InputError("a film of the hull needs tosses of one rigid body")
    drawn = learned.drawn
    corners = drawn.corner_pos
    inside = corners.mean(axis=0)
    reach = settings.hull_reach * float(np.abs(corners - inside).max())
    every = half_spaces(tosses)
    every = every.chosen(different(every, shape))
    down = np.array([corner_heights(drawn, toss.q).min(axis=0) < shape.contact_gap for toss in tosses])
    counts = np.unique(np.geomspace(1, len(tosses), settings.hull_pictures).round().astype(int))
    scale = 0.45 * min(settings.film_size) / reach
    frames = []
    for k, count in enumerate(counts.tolist()):
        view = view_from(np.deg2rad(-60) + 2 * np.pi * k / len(counts), np.deg2rad(20))
        place = _centred(view, inside, scale, settings.film_size)
        image = np.full((settings.film_size[1], settings.film_size[0], 3), 255, dtype=np.uint8)
        left = hull_within(every.chosen(every.toss < count), inside, reach)
        for points, color in ((left, MUTED), (corners, LOOKS["learned"].color)):
            draw_bodies(image, place, view, [(points, _UPRIGHT)], [wireframe(points)], rgb(color))
        for pixel, seen in zip(place(corners), np.atleast_1d(down[:count].any(axis=0)), strict=True):
            _mark(image, pixel, seen=bool(seen))
        words = f"{count} toss{'' if count == 1 else 'es'}   grey: where it may be   colour: learned"
        cv2.putText(image, words, (10, 20), cv2.FONT_HERSHEY_SIMPLEX, 0.42, rgb(INK), 1, cv2.LINE_AA)
        frames.append(image)
    return np.stack(frames)


def _centred(view: View, middle: Array, scale: float, size: tuple[int, int]) -> Place:
    """Points to pixels, with a point in the middle of the picture."""

    def place(points: Array) -> NDArray[np.int32]:
        pixel = view(points - middle) * [scale, -scale] + 0.5 * np.array(size)
        return np.asarray(np.round(pixel * 2**FRACTION), dtype=np.int32)

    return place


def _mark(image: Frames, pixel: NDArray[np.int32], *, seen: bool) -> None:
    """A dot for a corner that has been on the ground, a cross for one that has not."""
    if seen:
        cv2.circle(image, pixel.tolist(), 3 * 2**FRACTION, rgb(LOOKS["learned"].color), -1, cv2.LINE_AA, FRACTION)
        return
    x, y = (pixel / 2**FRACTION).round().astype(int).tolist()
    cv2.drawMarker(image, (x, y), rgb(UNSEEN), cv2.MARKER_TILTED_CROSS, 8, 2, cv2.LINE_AA)
