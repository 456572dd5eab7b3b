"""A Rauch-Tung-Striebel smoother over a batch of linear systems, in NumPy."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class LinearSystem:
    """δ_{k+1} = F_k δ_k + d_k + w_k, cov w_k = Q_k;  y_k = (first components of δ_k) + noise, cov R_k.

    Time is the first axis, the batch the second.

    Attributes:
        F: (n-1, b, N, N).
        d: (n-1, b, N).
        Q: (n-1, b, N, N).
        y: (n, b, m).
        R: (n, b, m, m).
        seen: Whether y is there, (n, b).
        P0: Covariance of δ_0 around zero, (N, N).
    """

    F: Array
    d: Array
    Q: Array
    y: Array
    R: Array
    seen: NDArray[np.bool_]
    P0: Array


@dataclass(frozen=True, slots=True)
class Filtered:
    """The Kalman filter's output.

    Attributes:
        mean: Given the past and y_k, (n, b, N).
        cov: Likewise, (n, b, N, N).
        mean_p: Given the past alone, (n, b, N).
        cov_p: Likewise, (n, b, N, N).
        innovation: y_k less its prediction, (n, b, m).
        innovation_cov: (n, b, m, m).
    """

    mean: Array
    cov: Array
    mean_p: Array
    cov_p: Array
    innovation: Array
    innovation_cov: Array


def filter_forward(system: LinearSystem) -> Filtered:
    """The Kalman filter of a batch (Joseph's form of the covariance).

    Args:
        system: The linear systems.
    """
    n, b, m = system.y.shape
    N = system.P0.shape[0]
    mean, cov = np.zeros((n, b, N)), np.zeros((n, b, N, N))
    mean_p, cov_p = np.zeros((n, b, N)), np.zeros((n, b, N, N))
    innovation, innovation_cov = np.zeros((n, b, m)), np.zeros((n, b, m, m))
    x, P = np.zeros((b, N)), np.broadcast_to(system.P0, (b, N, N)).copy()
    for k in range(n):
        if k:
            F = system.F[k - 1]
            x = (F @ x[..., None])[..., 0] + system.d[k - 1]
            P = F @ P @ F.swapaxes(-1, -2) + system.Q[k - 1]
            P = 0.5 * (P + P.swapaxes(-1, -2))
        mean_p[k], cov_p[k] = x, P
        innovation[k] = system.y[k] - x[:, :m]
        innovation_cov[k] = P[:, :m, :m] + system.R[k]
        K = np.linalg.solve(innovation_cov[k], P[:, :m, :]).swapaxes(-1, -2)
        K = np.where(system.seen[k][:, None, None], K, 0.0)
        x = x + (K @ innovation[k][..., None])[..., 0]
        # Joseph's form (1 - K H) P (1 - K H)ᵀ + K R Kᵀ stays positive where K is rounded
        rest = np.broadcast_to(np.eye(N), (b, N, N)).copy()
        rest[:, :, :m] -= K
        P = rest @ P @ rest.swapaxes(-1, -2) + K @ system.R[k] @ K.swapaxes(-1, -2)
        P = 0.5 * (P + P.swapaxes(-1, -2))
        mean[k], cov[k] = x, P
    return Filtered(mean, cov, mean_p, cov_p, innovation, innovation_cov)


def smooth(system: LinearSystem) -> tuple[Array, Array, Array]:
    """Means, covariances and lag-one covariances given all measurements.

    Args:
        system: The linear systems.

    Returns:
        δ (n, b, N), P (n, b, N, N), and C (n-1, b, N, N) = cov(δ_k, δ_{k+1}).
    """
    forward = filter_forward(system)
    mean, cov = forward.mean, forward.cov
    lag = np.zeros_like(system.F)
    for k in range(len(mean) - 2, -1, -1):
        # the smoother's gain P_k Fᵀ P_{k+1|k}^-1
        G = np.linalg.solve(forward.cov_p[k + 1], system.F[k] @ cov[k]).swapaxes(-1, -2)
        lag[k] = G @ cov[k + 1]
        mean[k] += (G @ (mean[k + 1] - forward.mean_p[k + 1])[..., None])[..., 0]
        P = cov[k] + G @ (cov[k + 1] - forward.cov_p[k + 1]) @ G.swapaxes(-1, -2)
        cov[k] = 0.5 * (P + P.swapaxes(-1, -2))
    return mean, cov, lag
