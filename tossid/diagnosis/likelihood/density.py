"""Student's density of whitened residuals: its scale in groups of rows, and its logarithm, in one pass each (Numba)."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from tossid.kernels import fused_kernel
from tossid.settings.diagnosis.likelihood import DensitySettings

Array = NDArray[np.float64]

_TURNS = 20
"""Steps of a scale's fixed-point iteration."""
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
    out = np.ones(count)
    _scales(np.ascontiguousarray(residuals), group, density.degrees_of_freedom, out)
    return out


@fused_kernel
def _scales(residuals, group, nu, out):  # type: ignore[no-untyped-def]
    W, L, K = residuals.shape
    squares = np.empty(W * L * K)
    for g in range(len(out)):
        n = 0
        for w in range(W):
            for row in range(L):
                if group[w, row] == g:
                    for k in range(K):
                        squares[n] = residuals[w, row, k] * residuals[w, row, k]
                        n += 1
        if n == 0:
            continue
        square = max(np.median(squares[:n]) / _MEDIAN, _LEAST)
        for _ in range(_TURNS):
            total = 0.0
            for i in range(n):
                total += squares[i] / (nu * square + squares[i])
            square = max((nu + 1.0) * square * total / n, _LEAST)
        out[g] = max(1.0, math.sqrt(square))


@fused_kernel
def log_densities(residuals, inside, scale, nu, out):  # type: ignore[no-untyped-def]
    """Write the log density of windows, but for constants, into `out` (n,).

    Args:
        residuals: (n, L, K) whitened.
        inside: (n, L) whether a row exists.
        scale: (n, L) of each row.
        nu: Student's degrees of freedom.
        out: (n,).
    """
    n, L, K = residuals.shape
    for w in range(n):
        total = 0.0
        for row in range(L):
            if inside[w, row]:
                s, product = scale[w, row], 1.0
                for k in range(K):
                    ratio = residuals[w, row, k] / s
                    product *= 1.0 + ratio * ratio / nu
                total -= 0.5 * (nu + 1.0) * math.log(product) + K * math.log(s)
        out[w] = total
