"""A tracker's slow errors: their covariance between the poses of a window, and the factors that whiten them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def slow_covariance(first: Array, then: Array, mix: Array, std: Array, scale: float) -> Array:
    """(W, K, L + 1, L + 1) covariances of errors that are a smooth Gaussian process over attitude.

    Args:
        first: (W, 4) first attitudes.
        then: (W, F, 4) attitudes, of which a row has that of the frame in its middle (mix (W, L, F)).
        mix: As of `Windows`.
        std: (K,) standard deviations.
        scale: Length scale of the process [rad].
    """
    W, L, _ = mix.shape
    out = np.zeros((W, len(std), L + 1, L + 1))
    if not std.any():
        return out
    middle = np.rint((mix * np.arange(mix.shape[2])).sum(2)).astype(int)
    attitude = np.concatenate([first[:, None], np.take_along_axis(then, middle[..., None], axis=1)], axis=1)
    # squared chord between rotation matrices, 1 - cos(angle): over the angle itself the kernel is not positive definite
    chord = 2 * (1 - (attitude @ attitude.mT) ** 2)
    exists = np.concatenate([np.ones((W, 1), bool), mix.any(axis=2)], axis=1)
    correlation = np.exp(-chord / scale**2) * exists[:, :, None] * exists[:, None, :]
    out[:] = std[:, None, None] ** 2 * correlation[:, None]
    return out


def inverse_factors(slow: Array, noise: Array) -> Array:
    """(W, K, L + 1, L + 1) inverse Cholesky factors of each channel's slow errors and noise.

    Args:
        slow: (W, K, L + 1, L + 1) covariances of slow errors, first pose and rows.
        noise: (W, L + 1, K) standard deviations.
    """
    cov = slow.copy()
    index = np.arange(cov.shape[-1])
    cov[..., index, index] += noise.transpose(0, 2, 1) ** 2
    out: Array = np.linalg.inv(np.linalg.cholesky(cov))
    return out
