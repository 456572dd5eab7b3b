"""Residuals of predictions: differences of poses, means over the frames of a row, and their one-sided derivatives."""

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


@kernel(allocates=False)
def one_sided(residuals, moved, steps, inside, out):  # type: ignore[no-untyped-def]
    """Write derivatives of predictions by first states, as differences to one side, into `out` (n, K L, 2 K).

    Args:
        residuals: (n, K L) at first states.
        moved: (m, n, K L) where one of the last m numbers of first states is larger by its step. By those before, which
            are positions along the ground, each row that exists moves as they do.
        steps: (2 K,) of the differences.
        inside: (n, L) whether a row exists.
        out: (n, K L, 2 K).
    """
    n, KL, K2 = out.shape
    given, K = K2 - len(moved), K2 // 2
    for w in range(n):
        for i in range(KL):
            for j in range(given):
                out[w, i, j] = 1.0 if i % K == j and inside[w, i // K] else 0.0
            for j in range(given, K2):
                out[w, i, j] = (residuals[w, i] - moved[j - given, w, i]) / steps[j]
