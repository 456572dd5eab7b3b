"""The Rauch-Tung-Striebel smoother against the one large least-squares problem that it solves."""

from __future__ import annotations

import numpy as np

from tossid.motion.smoothing.rts import LinearSystem, smooth


def test_the_smoother_is_least_squares() -> None:
    """Means and covariances of a random system are those of the one large normal equation."""
    rng = np.random.default_rng(2)
    n, N, m = 6, 4, 2
    F, d = rng.normal(size=(n - 1, 1, N, N)), rng.normal(size=(n - 1, 1, N))
    roots = rng.normal(size=(n - 1, 1, N, N))
    Q = roots @ roots.swapaxes(-1, -2)
    R = np.tile(np.diag([0.3, 0.1]), (n, 1, 1, 1))
    y, P0 = rng.normal(size=(n, 1, m)), np.diag([4.0, 3.0, 2.0, 1.0])
    seen = np.array([True, True, False, True, True, True])[:, None]
    mean, cov, lag = smooth(LinearSystem(F, d, Q, y, R, seen, P0))

    A, b = np.zeros((n * N, n * N)), np.zeros(n * N)
    A[:N, :N] += np.linalg.inv(P0)
    for k in range(n):
        if seen[k, 0]:
            W = np.linalg.inv(R[k, 0])
            A[k * N : k * N + m, k * N : k * N + m] += W
            b[k * N : k * N + m] += W @ y[k, 0]
    for k in range(n - 1):
        J = np.zeros((N, n * N))
        J[:, k * N : (k + 1) * N], J[:, (k + 1) * N : (k + 2) * N] = -F[k, 0], np.eye(N)
        W = np.linalg.inv(Q[k, 0])
        A += J.T @ W @ J
        b += J.T @ W @ d[k, 0]
    whole = np.linalg.inv(A)
    np.testing.assert_allclose(mean[:, 0].ravel(), whole @ b, atol=1e-8)
    for k in range(n):
        np.testing.assert_allclose(cov[k, 0], whole[k * N : (k + 1) * N, k * N : (k + 1) * N], atol=1e-8)
    for k in range(n - 1):
        np.testing.assert_allclose(lag[k, 0], whole[k * N : (k + 1) * N, (k + 1) * N : (k + 2) * N], atol=1e-8)
