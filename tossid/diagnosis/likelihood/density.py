"""Student's density of whitened residuals, by which one chaotic impact does not decide: its deviance and its scale."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tossid.settings.diagnosis.likelihood import DensitySettings

Array = NDArray[np.float64]

_TURNS, _CONVERGED = 20, 1e-6
"""Most steps of a scale's fixed-point iteration, and relative change of its square at which it ends."""
_LEAST = 1e-12
"""Square of the least scale: tosses without noise have no residuals."""
_MEDIAN = 0.55
"""Median of the square of what is distributed by Student's density of four degrees of freedom, with scale 1."""


def student_deviance(residuals: Array, density: DensitySettings = DensitySettings()) -> Array:
    """Student's deviance of whitened residuals, in the argument's shape.

    Args:
        residuals: Whitened.
        density: Student's degrees of freedom.
    """
    nu = density.degrees_of_freedom
    value: Array = (nu + 1) * np.log1p(residuals**2 / nu)
    return value


def student_scales(residuals: Array, group: NDArray[np.int64], count: int, density: DensitySettings) -> Array:
    """(count,) maximum likelihood scale of Student's density in each group of rows, at least 1, and 1 without rows.

    Args:
        residuals: (W, L, K) whitened.
        group: (W, L) of each row; -1 for a row that does not count.
        count: Number of groups.
        density: Student's degrees of freedom.
    """
    nu, scales = density.degrees_of_freedom, np.ones(count)
    for g in np.unique(group[group >= 0]):
        squares = residuals[group == g].ravel() ** 2
        square = max(float(np.median(squares)) / _MEDIAN, _LEAST)
        for _ in range(_TURNS):
            before, square = square, max((nu + 1) * square * float(np.mean(squares / (nu * square + squares))), _LEAST)
            if abs(square - before) < _CONVERGED * before:
                break
        scales[g] = max(1.0, square**0.5)
    return scales


def log_density(
    residuals: Array, inside: NDArray[np.bool_], scale: Array, density: DensitySettings = DensitySettings()
) -> Array:
    """(n,) log density of windows, but for a constant an entry.

    Args:
        residuals: (n, L, K) whitened.
        inside: (n, L) whether a row exists.
        scale: (n, L) of each row.
        density: Student's degrees of freedom.
    """
    deviance = student_deviance(residuals / scale[..., None], density).sum(2)
    out: Array = -np.where(inside, 0.5 * deviance + residuals.shape[2] * np.log(scale), 0.0).sum(1)
    return out
