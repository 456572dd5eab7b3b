"""Local parabolas: exact on a parabola, and not misled by one wrong frame."""

from __future__ import annotations

import numpy as np
import pytest

from tossid.motion.local_fits import local_parabolas, scatter

T = np.arange(60) / 148


def _flight() -> np.ndarray:
    return np.stack([0.5 * T, -0.2 * T, 1.0 + 2.0 * T - 0.5 * 9.81 * T**2], axis=1)


def test_a_parabola_is_fitted_exactly() -> None:
    v, a, outlier = local_parabolas(T, _flight(), 4, np.full(60, 1e-6))
    np.testing.assert_allclose(a, np.tile([0.0, 0.0, -9.81], (60, 1)), atol=1e-6)
    np.testing.assert_allclose(v[:, 2], 2.0 - 9.81 * T, atol=1e-8)
    assert not outlier.any()


def test_one_wrong_frame_is_left_out() -> None:
    x = _flight()
    x[30] += [0.0, 0.01, 0.0]
    _, a, outlier = local_parabolas(T, x, 4, np.full(60, 1e-4))
    np.testing.assert_array_equal(np.flatnonzero(outlier), [30])
    np.testing.assert_allclose(a, np.tile([0.0, 0.0, -9.81], (60, 1)), atol=1e-6)


def test_scatter_is_the_noises_standard_deviation() -> None:
    noise = 1e-4 * np.random.default_rng(0).normal(size=(4000, 3))
    assert scatter(np.diff(noise, n=3, axis=0)) == pytest.approx(1e-4, rel=0.05)
