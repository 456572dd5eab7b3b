"""Residuals of predictions: differences of poses, and their means over the frames of a row, in one pass."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from tossid.diagnosis.likelihood.states import pose_difference
from tossid.kernels import inlined_kernel, kernel

Array = NDArray[np.float64]

LARGEST = 3.0
"""Largest residual [m, rad]; also that of a frame whose simulation diverged."""


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


@inlined_kernel
def _residual(y, p, out):  # type: ignore[no-untyped-def]
    """Write y minus p (K + 1,) into out (K,), of at most `LARGEST`."""
    pose_difference(y, p, out)
    for k in range(out.shape[0]):
        if not math.isfinite(out[k]):
            out[k] = LARGEST
        out[k] = min(max(out[k], -LARGEST), LARGEST)
