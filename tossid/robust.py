"""Robust statistics: a scale that outliers do not set, and least squares in which they count less.

Huber (1964) bounds the influence of a residual; iteratively reweighted least squares (Holland and Welsch 1977) solve
for it: fit, weigh each item by its residual, fit again.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
T = TypeVar("T")

NORMAL_MAD = 1.4826
"""Standard deviation of a normal distribution over its median absolute deviation."""


def huber_weights(size: Array, limit: float | Array) -> Array:
    """Weights of least squares under Huber's loss: 1 up to a limit, limit / size beyond, (n,).

    Args:
        size: Absolute residuals, (n,).
        limit: From which on residuals count less, in the same unit.
    """
    return np.asarray(1 / np.maximum(1.0, size / limit))


def reweighted(
    fit: Callable[[Array], tuple[T, Array]], shape: int | tuple[int, ...], *, limit: float, iterations: int
) -> tuple[T, Array]:
    """Least squares with Huber's weights.

    Args:
        fit: Takes weights; returns the weighted solution, and the absolute residuals in units of their scale (their
            median, or a standard deviation).
        shape: Of the weights, which are 1 at first, and of the residuals.
        limit: Residual from which on an item counts less.
        iterations: Number of fits.

    Returns:
        The last solution, and the weights with which it was found.
    """
    weights = np.ones(shape)
    found, size = fit(weights)
    for _ in range(iterations - 1):
        weights = huber_weights(size, limit)
        found, size = fit(weights)
    return found, weights


def in_medians(size: Array) -> Array:
    """Absolute residuals in units of their median, (n,)."""
    return np.asarray(size / max(float(np.median(size)), 1e-12))
