"""What each toss says of an effect, regressed on what may be over the order: nothing, steps or a line.

Toss i has values y_i with information A_i, and scatters about the regression beyond it by tau. With W_i = A_i
(1 + tau² A_i)^-1 and a row x_i of the design, the coefficients B minimise Huber's cost (1964) of the distances

    |W_i^1/2 (y_i - x_i B)|,

and their covariance is the sandwich estimate over tosses (White 1980).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tossid.motion.sessions.change_points import variance_between

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Regression:
    """A robust regression of n tosses' values of d parameters on a constant and the columns of a design.

    Attributes:
        coefficients: (p, d), of the constant first.
        covariance: (p, d, p, d) of their errors.
        scatter: Between tosses, beyond their own errors, tau.
        cost: Twice Huber's cost, with log n for each coefficient (Schwarz 1978).
        n: Tosses that say something.
    """

    coefficients: Array
    covariance: Array
    scatter: float
    cost: float
    n: int


def robust_regression(
    values: Array, info: Array, design: Array, *, outlier: float, scatter: float | None = None
) -> Regression:
    """Values of tosses, regressed on a constant and a design.

    Args:
        values: (n, d).
        info: Their information, (n, d, d); 0 of tosses that say nothing.
        design: (n, p - 1).
        outlier: Standard deviations beyond which a toss counts no more than one at this distance.
        scatter: Between tosses; it is estimated if None.
    """
    rank = np.linalg.matrix_rank(info, hermitian=True)
    seen = rank > 0
    y, A, rank, n = values[seen], info[seen], rank[seen], int(seen.sum())
    X = np.column_stack([np.ones(n), design[seen]])
    d = y.shape[1]
    p = X.shape[1] * d
    off = y - X @ np.linalg.lstsq(X, y, rcond=None)[0]
    for _ in range(3 if scatter is None else 1):
        tau2 = variance_between(off, A, rank) if scatter is None else scatter**2
        W = A @ np.linalg.inv(np.eye(d) + tau2 * A)
        u = np.ones(n)
        for _ in range(20):
            H = np.einsum("n,ni,nj,nkl->ikjl", u, X, X, W).reshape(p, p)
            B = np.linalg.lstsq(H, np.einsum("n,ni,nkl,nl->ik", u, X, W, y).reshape(p), rcond=1e-10)[0].reshape(-1, d)
            off = y - X @ B
            size = np.sqrt(np.maximum(np.einsum("ni,nij,nj->n", off, W, off), 1e-300))
            u = np.minimum(1.0, outlier / size)
    g = np.einsum("n,ni,nkl,nl->nik", u, X, W, off).reshape(n, p)
    inverse = np.linalg.pinv(H, rcond=1e-10, hermitian=True)
    covariance = (inverse @ (g.T @ g) @ inverse * n / max(n - X.shape[1], 1)).reshape(X.shape[1], d, X.shape[1], d)
    return Regression(B, covariance, float(np.sqrt(tau2)), float(2 * huber(size, outlier).sum() + p * np.log(n)), n)


def huber(size: Array, outlier: float) -> Array:
    """Huber's cost of distances.

    Args:
        size: In standard deviations.
        outlier: From which on the cost is linear.
    """
    return np.where(size < outlier, 0.5 * size**2, outlier * (size - 0.5 * outlier))
