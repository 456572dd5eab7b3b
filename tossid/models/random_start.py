"""Starts of training of which nothing is right but the centre of mass, the mass and the number of corners."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from tossid.objects import ObjectModel
from tossid.settings.training import StartSettings


class DrawnStart(NamedTuple):
    """A start that was drawn.

    Attributes:
        object: With its corners, friction and inertia.
        inertia_rel: Inertia relative to the stated one.
    """

    object: ObjectModel
    inertia_rel: float


def draw_start(
    stated: ObjectModel,
    rng: np.random.Generator,
    settings: StartSettings | None = None,
    *,
    ball: bool = False,
    inertia: bool = True,
) -> DrawnStart:
    """An object with other corners, friction and inertia.

    Args:
        stated: The object as it is stated.
        rng: What draws.
        settings: Ranges.
        ball: Corners lie evenly in a ball about the body's origin; if not, each coordinate of a stated corner is off by
            a normal number.
        inertia: Whether inertia is drawn; if not it is as stated.
    """
    settings = settings or StartSettings()
    n = stated.n_corners
    direction = rng.normal(size=(n, 3))
    if ball:
        length = np.linalg.norm(direction, axis=1, keepdims=True)
        corners = settings.ball * direction / length * rng.random((n, 1)) ** (1 / 3)
    else:
        corners = stated.corner_pos + settings.offset_rel * 0.5 * stated.width * direction
    friction, scale = (float(np.exp(rng.uniform(*np.log(ends)))) for ends in (settings.friction, settings.inertia))
    scale = scale if inertia else 1.0
    drawn = stated.with_changes(corner_pos=corners, friction=friction, inertia=scale * stated.inertia)
    return DrawnStart(drawn, scale)
