"""Misses of predictions, row by row: differences of poses and their means over a row's frames, in one pass."""

from __future__ import annotations

import math

import numba
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

LOST = 3.0
"""Miss [m, rad] that counts for a frame whose simulation diverged."""
_SMALL = 1e-8
"""Sine of half an angle, below which the angle is taken as twice that."""


def mean_misses(y: Array, predicted: Array, mix: Array, steps: NDArray[np.int64]) -> Array:
    """(n W, L, K) misses: position [m], rotation vector in the body's frame [rad], joints; 0 in rows that are none.

    Args:
        y: (W, F, K + 1) measured poses.
        predicted: (n W, f, K + 1) poses, n times the windows, for at least as many frames as any has.
        mix: (W, L, F) rows' means of frames.
        steps: (W,) frames of each window.
    """
    out = np.zeros((len(predicted), mix.shape[1], y.shape[2] - 1))
    _mean_misses(y, np.ascontiguousarray(predicted), mix, steps, out)
    return out


@numba.njit(cache=True, error_model="numpy", nogil=True)
def _mean_misses(y, predicted, mix, steps, out):  # type: ignore[no-untyped-def]
    K = out.shape[2]
    miss = np.empty(K)
    for b in range(predicted.shape[0]):
        w = b % y.shape[0]
        for f in range(steps[w]):
            _miss(y[w, f], predicted[b, f], miss)
            for row in range(mix.shape[1]):
                share = mix[w, row, f]
                if share != 0.0:
                    for k in range(K):
                        out[b, row, k] += share * miss[k]


@numba.njit(cache=True, error_model="numpy", nogil=True)
def _miss(y, p, out):  # type: ignore[no-untyped-def]
    """out (K,): y less p (K + 1,), the rotation as log(p^-1 y); see `tossid.rotations.quat_boxminus`."""
    for k in range(3):
        out[k] = y[k] - p[k]
    aw, ax, ay, az = p[3], -p[4], -p[5], -p[6]
    bw, bx, by, bz = y[3], y[4], y[5], y[6]
    w = aw * bw - (ax * bx + ay * by + az * bz)
    x = aw * bx + bw * ax + (ay * bz - az * by)
    y_ = aw * by + bw * ay + (az * bx - ax * bz)
    z = aw * bz + bw * az + (ax * by - ay * bx)
    s = math.sqrt(x * x + y_ * y_ + z * z)
    angle = 2.0 * math.atan2(s, abs(w))
    scale = angle / s if s > _SMALL else 2.0
    if w < 0.0:
        scale = -scale
    out[3], out[4], out[5] = scale * x, scale * y_, scale * z
    for k in range(6, out.shape[0]):
        out[k] = y[k + 1] - p[k + 1]
    for k in range(out.shape[0]):
        if not math.isfinite(out[k]):
            out[k] = LOST
        out[k] = min(max(out[k], -LOST), LOST)
