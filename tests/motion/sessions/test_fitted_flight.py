"""A flight that is fitted to a few frames goes on as the body does."""

from __future__ import annotations

import numpy as np
import pytest

from tests.motion.bounced import GRAVITY, flight
from tossid.motion.sessions.fitted_flight import FittedFlight
from tossid.objects import ObjectModel
from tossid.rotations import quat_exp
from tossid.types import PoseTrack


@pytest.mark.parametrize("seed", range(4))
def test_a_flight_goes_on_beyond_its_frames(cube: ObjectModel, seed: int) -> None:
    rng = np.random.default_rng(seed)
    slab = cube.with_changes(inertia=cube.inertia * np.array([1.0, 1.3, 1.7]))
    pose = np.concatenate([rng.normal(size=3), quat_exp(rng.normal(size=3))])
    t = np.arange(20) / 250
    q = flight(slab, pose, rng.normal(size=3), 4.0 * rng.normal(size=3), t)
    track, some = PoseTrack("a", t, q), slice(0, 12)
    fitted = FittedFlight.fitted(track, some, slab, GRAVITY)
    assert fitted.misfit(track, some, 0.05) < 2e-5
    off = fitted.off(t[12:], q[12:], 0.05)
    assert np.abs(off[:, :3]).max() < 1e-9
    assert np.abs(off[:, 3:]).max() < 5e-4
    same = fitted.distance(fitted, t, t, 0.05)
    assert np.abs(same).max() == 0
