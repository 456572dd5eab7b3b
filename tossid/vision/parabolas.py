"""Velocity, acceleration and noise of a tracked point, by parabolas through each frame's neighbours."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

BESIDE = 4.0
"""Noise by which a frame's distance from the parabola calls for a second look."""
FITS = 2.0
"""Noise within which (rms) the other frames lie on a parabola if one of them is left out."""


def scatter(third: Array) -> float:
    """Standard deviation of a quantity from its third differences, robustly: of smooth motion they are far smaller."""
    return float(1.4826 * np.median(np.abs(third)) / np.sqrt(20.0))


def local_parabolas(t: Array, x: Array, half: int, noise: Array) -> tuple[Array, Array, NDArray[np.bool_]]:
    """Velocity [m/s] and acceleration [m/s²] at each frame, from a parabola through it and `half` frames on each side.

    Where one frame lies beside a parabola that fits all others, it is left out: one bad pose is no push, and what comes
    after an impact says nothing of the flight before.

    Args:
        t: (n,). x: (n, 3) [m]. noise: (n,) standard deviation [m].

    Returns:
        (n, 3) each, and which frames lie beside their own parabola (n,).
    """
    n, width = len(t), 2 * half + 1
    first = np.clip(np.arange(n) - half, 0, max(n - width, 0))
    index = np.minimum(first[:, None] + np.arange(width), n - 1)
    s = t[index] - t[:, None]
    basis = np.stack([np.ones_like(s), s, 0.5 * s**2], axis=-1)
    fitted = np.linalg.pinv(basis) @ x[index]
    off = np.linalg.norm(x[index] - basis @ fitted, axis=-1)
    beside = np.zeros(n, dtype=bool)
    doubtful = np.flatnonzero(off.max(axis=1) > BESIDE * noise) if n >= width > 4 else np.zeros(0, dtype=np.int64)
    if len(doubtful):
        best = np.full(len(doubtful), np.inf)
        for left_out in range(width):
            keep = np.delete(np.arange(width), left_out)
            B, X = basis[doubtful][:, keep], x[index[doubtful]][:, keep]
            again = np.linalg.pinv(B) @ X
            rms = np.sqrt(np.mean((X - B @ again) ** 2, axis=(1, 2)))
            better = (rms < FITS * noise[doubtful]) & (rms < best)
            fitted[doubtful[better]], best[better] = again[better], rms[better]
            beside[doubtful[better]] = index[doubtful[better], left_out] == doubtful[better]
    return fitted[:, 1], fitted[:, 2], beside
