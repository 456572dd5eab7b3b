"""Round corners in the time-stepping kernel: where the lowest point of a corner is.

`tossid.objects.roundness` has the equation. An object whose corners are points has the type `Points`; for it all of
this falls away when a kernel is compiled.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tossid.kernels import by_type, implements
from tossid.objects import Roundness
from tossid.objects.roundness import FLAT

Array = NDArray[np.float64]


class Points(NamedTuple):
    """Corners that are points."""


class Rounds(NamedTuple):
    """Corners of which some are round; the fields are those of `Roundness`, and least.

    Attributes:
        radius: (n_c,) [m].
        root: (n_c, 3, 3) [m].
        turned: (n_c, 3, 3) [m].
        flat: (n_c, 3).
        least: (n_c,) |Q d| below which a disc lies flat [m].
    """

    radius: Array
    root: Array
    turned: Array
    flat: Array
    least: Array


Shape = Points | Rounds


def shape_of(roundness: Roundness | None) -> Shape:
    """What kernels take for an object's round corners.

    Args:
        roundness: Of the object.
    """
    if roundness is None:
        return Points()
    least = FLAT * np.abs(roundness.root).max(axis=(1, 2))
    radius, root, turned, flat = (np.ascontiguousarray(part) for part in roundness)
    return Rounds(radius, root, turned, flat, least)


@by_type
def is_round(shape):  # type: ignore[no-untyped-def]
    """Whether some corner is round; known when compiled."""
    raise NotImplementedError


@by_type
def lowest_offset(shape, c, up0, up1, up2):  # type: ignore[no-untyped-def]
    """The lowest point of corner c from the corner, given the vertical, all in the axes of the corner's body [m]."""
    raise NotImplementedError


@implements(is_round, Points)
def _points_are_not(shape):  # type: ignore[no-untyped-def]
    return False


@implements(is_round, Rounds)
def _rounds_are(shape):  # type: ignore[no-untyped-def]
    return True


@implements(lowest_offset, Points)
def _no_offset(shape, c, up0, up1, up2):  # type: ignore[no-untyped-def]
    return 0.0, 0.0, 0.0


@implements(lowest_offset, Rounds)
def _offset(shape, c, up0, up1, up2):  # type: ignore[no-untyped-def]
    Q, P, r = shape.root, shape.turned, shape.radius[c]
    w0 = -(Q[c, 0, 0] * up0 + Q[c, 0, 1] * up1 + Q[c, 0, 2] * up2)
    w1 = -(Q[c, 1, 0] * up0 + Q[c, 1, 1] * up1 + Q[c, 1, 2] * up2)
    w2 = -(Q[c, 2, 0] * up0 + Q[c, 2, 1] * up1 + Q[c, 2, 2] * up2)
    size = math.sqrt(w0 * w0 + w1 * w1 + w2 * w2)
    if size <= shape.least[c]:
        w0, w1, w2 = shape.flat[c, 0], shape.flat[c, 1], shape.flat[c, 2]
    else:
        w0, w1, w2 = w0 / size, w1 / size, w2 / size
    return (
        P[c, 0, 0] * w0 + P[c, 0, 1] * w1 + P[c, 0, 2] * w2 - r * up0,
        P[c, 1, 0] * w0 + P[c, 1, 1] * w1 + P[c, 1, 2] * w2 - r * up1,
        P[c, 2, 0] * w0 + P[c, 2, 1] * w1 + P[c, 2, 2] * w2 - r * up2,
    )


@by_type
def bulge(shape, c, up0, up1, up2, w0, w1, w2):  # type: ignore[no-untyped-def]
    """Second derivative in time of how far corner c reaches down, at a constant spin w [m/s²].

    With s = |Q u|, the vertical u in the body's axes turns as du/dt = u x w.
    """
    raise NotImplementedError


@implements(bulge, Points)
def _no_bulge(shape, c, up0, up1, up2, w0, w1, w2):  # type: ignore[no-untyped-def]
    return 0.0


@implements(bulge, Rounds)
def _bulge(shape, c, up0, up1, up2, w0, w1, w2):  # type: ignore[no-untyped-def]
    Q = shape.root
    d0, d1, d2 = up1 * w2 - up2 * w1, up2 * w0 - up0 * w2, up0 * w1 - up1 * w0
    e0, e1, e2 = d1 * w2 - d2 * w1, d2 * w0 - d0 * w2, d0 * w1 - d1 * w0
    squared, along, turned, bent = 0.0, 0.0, 0.0, 0.0
    for i in range(3):
        x = Q[c, i, 0] * up0 + Q[c, i, 1] * up1 + Q[c, i, 2] * up2
        y = Q[c, i, 0] * d0 + Q[c, i, 1] * d1 + Q[c, i, 2] * d2
        z = Q[c, i, 0] * e0 + Q[c, i, 1] * e1 + Q[c, i, 2] * e2
        squared, along, turned, bent = squared + x * x, along + x * y, turned + y * y, bent + x * z
    size = math.sqrt(squared)
    if size <= shape.least[c]:
        return 0.0
    return (turned + bent) / size - along * along / (size * squared)
