"""Residuals of predictions: differences of poses, and their means over the frames of a row, in one pass."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from tossid.kernels import kernel

Array = NDArray[np.float64]

LARGEST = 3.0
"""Largest residual [m, rad]; also that of a frame whose simulation diverged."""
_SMALL = 1e-8
"""Sine of half an angle below which the angle is twice that."""


def mean_residuals(y: Array, predicted: Array, mix: Array, steps: NDArray[np.int64], index: NDArray[np.int64]) -> Array:
    """(n, L, K) measured minus predicted, averaged over each row's frames; 0 in rows that do not exist.

    Args:
        y: (W, F, K + 1) measured poses: position [m], quaternion wxyz, joints [rad].
        predicted: (n, f, K + 1) poses, of at least as many frames as any of their windows has.
        mix: (W, L, F) weights with which a row is the mean of frames.
        steps: (W,) frames of each window.
        index: (n,) the window of each prediction.

    Returns:
        Position [m, world], rotation vector [rad, predicted body frame], joints [rad].
    """
    out = np.zeros((len(predicted), mix.shape[1], y.shape[2] - 1))
    _mean_residuals(y, np.ascontiguousarray(predicted), mix, steps, index, out)
    return out


@kernel
def _mean_residuals(y, predicted, mix, steps, index, out):  # type: ignore[no-untyped-def]
    K = out.shape[2]
    one = np.empty(K)
    for b in range(predicted.shape[0]):
        w = index[b]
        for f in range(steps[w]):
            _residual(y[w, f], predicted[b, f], one)
            for row in range(mix.shape[1]):
                weight = mix[w, row, f]
                if weight != 0.0:
                    for k in range(K):
                        out[b, row, k] += weight * one[k]


@kernel
def _residual(y, p, out):  # type: ignore[no-untyped-def]
    """Write y minus p (K + 1,) into out (K,), the rotation as log(p^-1 y): `tossid.rotations.quat_boxminus`."""
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
            out[k] = LARGEST
        out[k] = min(max(out[k], -LARGEST), LARGEST)
