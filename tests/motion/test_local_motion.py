"""Local parabolas, runs of flags, and the free flight in a track that is held, thrown and lies."""

from __future__ import annotations

import numpy as np
import pytest

from tossid.motion.local_motion import LocalMotion, alone, local_parabolas, runs, scatter
from tossid.objects import ObjectModel
from tossid.settings.segmentation import SegmentSettings
from tossid.types import PoseTrack


def test_runs_and_lone_flags() -> None:
    flags = np.array([True, True, False, True, False, False, True])
    assert list(runs(flags)) == [(0, 1), (3, 3), (6, 6)]
    np.testing.assert_array_equal(alone(flags), [False, False, False, True, False, False, True])


def test_a_throw_between_being_held_and_caught_is_one_flight(cube: ObjectModel) -> None:
    rng, dt = np.random.default_rng(0), 1 / 148
    t = np.arange(150) * dt
    fly = np.clip(t - t[50], 0.0, t[100] - t[50])
    q = np.zeros((150, 7))
    q[:, 2], q[:, 3] = 0.5 + 2.0 * fly - 0.5 * 9.81 * fly**2, 1.0
    q[:, :3] += 3e-5 * rng.normal(size=(150, 3))
    motion = LocalMotion(cube, PoseTrack("throw", t, q), dt, 9.81, 1e-3, SegmentSettings())
    ((first, last),) = motion.flights(0, 149)
    assert abs(first - 50) <= 2
    assert abs(last - 100) <= 2
    assert motion.carried[:45].all()
    np.testing.assert_allclose(motion.spin, 0.0, atol=1e-6)


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
