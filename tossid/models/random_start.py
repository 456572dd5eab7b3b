"""Random starts of training, of which nothing is right but the centre of mass, the mass and the number of corners.

Pfrommer, Halm and Posa (arXiv 2009.11193) train from such starts: what a model learns should not depend on them.
"""

from __future__ import annotations

import numpy as np

from tossid.objects import ObjectModel

BALL = 0.2
"""Radius of the ball in which corners lie evenly [m]."""
CORNER_OFFSET = 0.4
"""Standard deviation of each coordinate of the other corners from the stated ones, in half widths, as in the paper."""
FRICTION = (0.05, 1.5)
INERTIA = (0.25, 4.0)
"""Ranges of friction, and of inertia relative to the stated one; both are log-uniform."""


def draw_start(
    stated: ObjectModel, rng: np.random.Generator, *, ball: bool = False, inertia: bool = True
) -> tuple[ObjectModel, float]:
    """An object with other corners, friction and inertia, and its inertia relative to the stated one.

    Args:
        stated: The object as it is stated.
        rng: What draws.
        ball: Corners lie evenly in a ball about the body's origin; if not, each coordinate of a stated corner is off by
            a normal number.
        inertia: Whether inertia is drawn; if not it is as stated.
    """
    direction = rng.normal(size=stated.corner_pos.shape)
    if ball:
        length = np.linalg.norm(direction, axis=1, keepdims=True)
        corners = BALL * direction / length * rng.random((len(direction), 1)) ** (1 / 3)
    else:
        corners = stated.corner_pos + CORNER_OFFSET * 0.5 * stated.width * direction
    friction, scale = (float(np.exp(rng.uniform(*np.log(ends)))) for ends in (FRICTION, INERTIA))
    scale = scale if inertia else 1.0
    return stated.with_changes(corner_pos=corners, friction=friction, inertia=scale * stated.inertia), scale
