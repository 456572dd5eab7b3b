"""The inner loop of undistortion (Numba)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tossid.kernels import kernel

Array = NDArray[np.float64]


@kernel
def undistort_brown(target: Array, k: tuple[float, float, float, float, float], limit: float) -> Array:
    """Normalised coordinates whose distortion (Brown 1966, as `Camera.distort` has it) is the target's.

    Newton's method, to 1e-10, from the target itself, drawn in where it lies near the lens model's limit.

    Args:
        target: (n, 2) distorted normalised coordinates.
        k: k1, k2, p1, p2, k3.
        limit: `Camera.radius_limit`.

    Returns:
        (n, 2), NaN where it does not converge, or beyond the limit.
    """
    k1, k2, p1, p2, k3 = k
    out = np.empty_like(target)
    for i in range(len(target)):
        x, y = target[i]
        radius = np.hypot(x, y)
        if radius > 0.7 * limit:
            x, y = x * 0.7 * limit / radius, y * 0.7 * limit / radius
        step = np.inf
        for _ in range(20):
            r2 = x * x + y * y
            radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
            slope = k1 + r2 * (2 * k2 + 3 * r2 * k3)
            ex = x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x) - target[i, 0]
            ey = y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y - target[i, 1]
            a = radial + 2 * x * x * slope + 2 * p1 * y + 6 * p2 * x
            b = 2 * x * y * slope + 2 * p1 * x + 2 * p2 * y
            d = radial + 2 * y * y * slope + 6 * p1 * y + 2 * p2 * x
            det = a * d - b * b
            mx, my = (d * ex - b * ey) / det, (a * ey - b * ex) / det
            x, y = x - mx, y - my
            step = max(abs(mx), abs(my))
            if not step > 1e-12:
                break
        good = step < 1e-10 and np.hypot(x, y) < limit
        out[i, 0], out[i, 1] = (x, y) if good else (np.nan, np.nan)
    return out
