"""Undistortion inverts Brown's model within the lens's limit, and gives NaN beyond."""

from __future__ import annotations

import numpy as np

from tossid.vision.cameras._undistort import undistort_brown

K = (-0.3, 0.1, 0.001, -0.0005, -0.02)


def _distorted(xy: np.ndarray) -> np.ndarray:
    """Brown 1966."""
    k1, k2, p1, p2, k3 = K
    x, y = xy.T
    r2 = x * x + y * y
    radial = 1 + k1 * r2 + k2 * r2**2 + k3 * r2**3
    return np.stack(
        [x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x), y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y], -1
    )


def test_undistorted_points_distort_to_their_target() -> None:
    xy = np.random.default_rng(0).uniform(-0.7, 0.7, (500, 2))
    np.testing.assert_allclose(undistort_brown(_distorted(xy), K, 2.0), xy, atol=1e-10)


def test_points_beyond_the_limit_are_nan() -> None:
    xy = np.array([[0.2, 0.0], [0.9, 0.0]])
    assert np.isnan(undistort_brown(_distorted(xy), K, 0.5)).all(axis=1).tolist() == [False, True]
