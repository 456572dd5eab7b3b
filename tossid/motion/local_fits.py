"""Velocity, acceleration and noise of a tracked point, by parabolas through each frame's neighbours."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

OUTLIER = 4.0
"""Residual over the noise from which one of a fit's frames may be an outlier; then it is fitted without one."""
INLIERS = 2.0
"""It is one if the rms residual of the others, fitted without it, is below this many times the noise."""


def scatter(third: Array) -> float:
    """Robust standard deviation of a quantity's noise: the third differences of smooth motion are far smaller.

    Args:
        third: Third differences, of any shape.
    """
    return float(1.4826 * np.median(np.abs(third)) / np.sqrt(20.0))


def local_parabolas(t: Array, x: Array, half: int, noise: Array) -> tuple[Array, Array, NDArray[np.bool_]]:
    """Velocity and acceleration at each frame, from a parabola through it and `half` frames on each side.

    Where one frame is an outlier of a parabola that fits all others, it is left out: one wrong pose is no acceleration.

    Args:
        t: Times [s], (n,).
        x: Positions [m], (n, 3).
        half: Frames on each side.
        noise: Standard deviation of x [m], (n,).

    Returns:
        Velocities [m/s] (n, 3), accelerations [m/s²] (n, 3), and which frames are outliers of their own parabola (n,).
    """
    n, width = len(t), 2 * half + 1
    first = np.clip(np.arange(n) - half, 0, max(n - width, 0))
    index = np.minimum(first[:, None] + np.arange(width), n - 1)
    s = t[index] - t[:, None]
    basis = np.stack([np.ones_like(s), s, 0.5 * s**2], axis=-1)
    fitted = np.linalg.pinv(basis) @ x[index]
    off = np.linalg.norm(x[index] - basis @ fitted, axis=-1)
    outlier = np.zeros(n, dtype=bool)
    suspect = np.flatnonzero(off.max(axis=1) > OUTLIER * noise) if n >= width > 4 else np.zeros(0, dtype=np.int64)
    if len(suspect):
        best = np.full(len(suspect), np.inf)
        for left_out in range(width):
            keep = np.delete(np.arange(width), left_out)
            B, X = basis[suspect][:, keep], x[index[suspect]][:, keep]
            again = np.linalg.pinv(B) @ X
            rms = np.sqrt(np.mean((X - B @ again) ** 2, axis=(1, 2)))
            better = (rms < INLIERS * noise[suspect]) & (rms < best)
            fitted[suspect[better]], best[better] = again[better], rms[better]
            outlier[suspect[better]] = index[suspect[better], left_out] == suspect[better]
    return fitted[:, 1], fitted[:, 2], outlier
