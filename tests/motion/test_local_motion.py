"""Runs of flags, and the free flight in a track that is held, thrown and lies."""

from __future__ import annotations

import numpy as np

from tossid.motion.local_motion import LocalMotion, alone, runs
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
