"""Round corners in the time-stepping kernel: where the lowest point of a corner is.

`tossid.objects.roundness` has the equation. Corners that are points have empty arrays, and one question to ask.
"""

from __future__ import annotations

import math

import numpy as np

from tossid.kernels import inlined_kernel, lean_kernel
from tossid.objects import Roundness
from tossid.objects.roundness import FLAT

POINTS = Roundness(np.zeros(0), np.zeros((0, 3, 3)), np.zeros((0, 3, 3)), np.zeros((0, 3)))
"""Of corners that are points."""


@inlined_kernel
def is_round(rounds):  # type: ignore[no-untyped-def]
    """Whether some corner is round."""
    return rounds.radius.shape[0] > 0


@inlined_kernel
def lies_flat(rounds, c, size):  # type: ignore[no-untyped-def]
    """Whether a disc whose |Q d| is `size` lies flat."""
    largest = 0.0
    for i in range(3):
        for j in range(3):
            largest = max(largest, abs(rounds.root[c, i, j]))
    return size <= FLAT * largest


@lean_kernel
def lowest_offset(rounds, c, up0, up1, up2):  # type: ignore[no-untyped-def]
    """The lowest point of corner c from the corner, given the vertical, all in the axes of the corner's body [m]."""
    Q, P, r = rounds.root, rounds.turned, rounds.radius[c]
    w0 = -(Q[c, 0, 0] * up0 + Q[c, 0, 1] * up1 + Q[c, 0, 2] * up2)
    w1 = -(Q[c, 1, 0] * up0 + Q[c, 1, 1] * up1 + Q[c, 1, 2] * up2)
    w2 = -(Q[c, 2, 0] * up0 + Q[c, 2, 1] * up1 + Q[c, 2, 2] * up2)
    size = math.sqrt(w0 * w0 + w1 * w1 + w2 * w2)
    if lies_flat(rounds, c, size):
        w0, w1, w2 = rounds.flat[c, 0], rounds.flat[c, 1], rounds.flat[c, 2]
    else:
        w0, w1, w2 = w0 / size, w1 / size, w2 / size
    return (
        P[c, 0, 0] * w0 + P[c, 0, 1] * w1 + P[c, 0, 2] * w2 - r * up0,
        P[c, 1, 0] * w0 + P[c, 1, 1] * w1 + P[c, 1, 2] * w2 - r * up1,
        P[c, 2, 0] * w0 + P[c, 2, 1] * w1 + P[c, 2, 2] * w2 - r * up2,
    )


@lean_kernel
def bulge(rounds, c, up0, up1, up2, w0, w1, w2):  # type: ignore[no-untyped-def]
    """Second derivative in time of how far corner c reaches down, at a constant spin w [m/s²].

    With s = |Q u|, the vertical u in the body's axes turns as du/dt = u x w.
    """
    Q = rounds.root
    d0, d1, d2 = up1 * w2 - up2 * w1, up2 * w0 - up0 * w2, up0 * w1 - up1 * w0
    e0, e1, e2 = d1 * w2 - d2 * w1, d2 * w0 - d0 * w2, d0 * w1 - d1 * w0
    squared, along, turned, bent = 0.0, 0.0, 0.0, 0.0
    for i in range(3):
        x = Q[c, i, 0] * up0 + Q[c, i, 1] * up1 + Q[c, i, 2] * up2
        y = Q[c, i, 0] * d0 + Q[c, i, 1] * d1 + Q[c, i, 2] * d2
        z = Q[c, i, 0] * e0 + Q[c, i, 1] * e1 + Q[c, i, 2] * e2
        squared, along, turned, bent = squared + x * x, along + x * y, turned + y * y, bent + x * z
    size = math.sqrt(squared)
    if lies_flat(rounds, c, size):
        return 0.0
    return (turned + bent) / size - along * along / (size * squared)
