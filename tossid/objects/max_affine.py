"""The max-affine regression of a support function: vertices, each fitted to the frames in which it is lowest.

Magnani and Boyd, "Convex piecewise-linear fitting", 2009, with a redescending loss for frames that are no contacts.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tossid.objects.half_spaces import HalfSpaces
from tossid.settings.objects import ShapeSettings

Array = NDArray[np.float64]


class Fit(NamedTuple):
    """Vertices that were fitted.

    Attributes:
        vertices: (n, 3) [m].
        ground: (3,) height at the origin [m] and slopes along x and y.
        lowest: (k,) the lowest vertex of each frame.
        gap: (k,) its height over the ground [m].
        loss: Sum over frames.
    """

    vertices: Array
    ground: Array
    lowest: NDArray[np.int64]
    gap: Array
    loss: float


def ground_slope(spaces: HalfSpaces) -> Array:
    """Derivative of the ground's height under the body with respect to its height at the origin and its slopes."""
    return np.column_stack([np.ones(len(spaces.height)), spaces.place])


def loss_of(gap: Array, free: NDArray[np.bool_], scale: float, settings: ShapeSettings) -> Array:
    """Loss of each gap: Huber's below the ground, Geman and McClure's above, none in free flight; in variances."""
    knee = 2 * settings.noise
    below = np.where(gap > -knee, gap**2, -2 * knee * gap - knee**2)
    above = np.where(free, 0.0, scale**2 * gap**2 / (scale**2 + gap**2))
    return np.where(gap < 0, below, above) / settings.noise**2


def weights_of(gap: Array, free: NDArray[np.bool_], scale: float, settings: ShapeSettings) -> Array:
    """Weights of the least squares that have the loss's gradient."""
    above = np.where(free, 0.0, 1 / (1 + (gap / scale) ** 2) ** 2)
    return np.where(gap < 0, 1 / np.maximum(1, -gap / (2 * settings.noise)), above)


def fit_vertices(
    spaces: HalfSpaces, start: Array, ground: Array, settings: ShapeSettings, *, gap: float, level: bool = False
) -> Fit:
    """Fit vertices, and the ground unless it is level, by reweighted least squares.

    Args:
        spaces: Frames near the ground.
        start: Vertices to begin with, (n, 3).
        ground: The ground to begin with, (3,).
        settings: Noise, scales and iterations.
        gap: Scale of the loss above the ground to begin with [m]; it falls to `settings.gap`.
        level: The ground is z = 0.
    """
    X, g, G, n = start.copy(), ground.copy(), ground_slope(spaces), len(start)
    for _ in range(settings.iterations):
        gap = max(settings.gap, 0.8 * gap)
        lowest, r = _residuals(spaces, G, X, g)
        w = weights_of(r, spaces.free, gap, settings)
        rise, turn = _step(spaces.down, G, w, r, lowest, n, hold=settings.inertia, level=level)
        X += rise
        g += turn
        step = np.append(rise.ravel(), turn)
        if gap == settings.gap and np.abs(step).max() < settings.converged:
            break
    lowest, r = _residuals(spaces, G, X, g)
    return Fit(X, g, lowest, r, float(loss_of(r, spaces.free, settings.gap, settings).sum()))


def _residuals(spaces: HalfSpaces, G: Array, X: Array, g: Array) -> tuple[NDArray[np.int64], Array]:
    """The lowest vertex of each frame, and its gap [m]."""
    reach = spaces.down @ X.T
    lowest = reach.argmax(axis=1)
    return lowest, spaces.height - G @ g - reach[np.arange(len(lowest)), lowest]


def _step(
    down: Array, G: Array, w: Array, r: Array, lowest: NDArray[np.int64], n: int, *, hold: float, level: bool
) -> tuple[Array, Array]:
    """The Gauss-Newton step of vertices (n, 3) and ground (3,), zero where it is level.

    A frame depends on one vertex and the ground, so that the vertices' 3 x 3 blocks are eliminated first.
    """

    def sums(values: Array, others: Array) -> Array:
        """Weighted sums of products over each vertex's frames, (n, ., .)."""
        products = [np.bincount(lowest, w * a * b, minlength=n) for a in values.T for b in others.T]
        return np.asarray(np.stack(products, axis=-1).reshape(n, values.shape[1], others.shape[1]), dtype=float)

    A, b = sums(down, down) + hold * np.eye(3), sums(down, r[:, None])
    if level:
        return np.asarray(np.linalg.solve(A, b)[..., 0]), np.zeros(3)
    C = sums(down, G)
    solved = np.linalg.solve(A, np.concatenate([b, C], axis=-1))
    own, by_ground = solved[..., 0], solved[..., 1:]
    left = (G * w[:, None]).T @ G + 1e-9 * np.eye(3) - np.einsum("nij,nik->jk", C, by_ground)
    turn = np.linalg.solve(left, G.T @ (w * r) - np.einsum("nij,ni->j", C, own))
    return own - by_ground @ turn, turn
