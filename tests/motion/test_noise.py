"""Noise levels are recovered from tracks of known noise, and real ones are what they were found to be."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tests.motion.bouncing import bounce, tracked
from tossid.errors import InputError
from tossid.motion import pose_noise, velocity_noise
from tossid.objects import ObjectModel
from tossid.store import read_contactnets
from tossid.types import Phase, PoseTrack


@pytest.mark.parametrize(("position", "rotation"), [(0.15e-3, 1.5e-3), (0.02e-3, 0.3e-3), (1e-3, 10e-3)])
def test_known_noise_is_recovered(cube: ObjectModel, position: float, rotation: float) -> None:
    rng = np.random.default_rng(0)
    truths = bounce(cube, rng, tosses=20, frames=50)
    tracks = [tracked(x, rng, position=position, rotation=rotation, with_cov=False) for x in truths]
    found = pose_noise(tracks, cube)
    assert found.source == "flight residuals"
    sigma = np.sqrt(np.diag(found.q_cov))
    np.testing.assert_allclose(sigma, [position] * 3 + [rotation] * 3, rtol=0.2)


def test_glitches_do_not_count(cube: ObjectModel) -> None:
    rng = np.random.default_rng(1)
    tracks = [tracked(x, rng, with_cov=False) for x in bounce(cube, rng, tosses=20, frames=50)]
    for track in tracks[::3]:
        track.q[8, :3] += 0.02
    sigma = np.sqrt(np.diag(pose_noise(tracks, cube).q_cov))
    np.testing.assert_allclose(sigma[:3], 0.15e-3, rtol=0.4)


def test_without_flight_the_quiet_half_serves(cube: ObjectModel) -> None:
    rng = np.random.default_rng(2)
    n = 100
    q = np.tile([0, 0, 0.0524, 1.0, 0, 0, 0], (n, 1))
    q[:, :3] += rng.normal(size=(n, 3)) * 1e-4
    found = pose_noise([PoseTrack("x", np.arange(n) / 148, q)], cube)
    assert "quieter half" in found.source
    np.testing.assert_allclose(np.sqrt(np.diag(found.q_cov))[:3], 1e-4, rtol=0.5)


def test_too_short_a_track_is_refused(cube: ObjectModel) -> None:
    q = np.tile([0, 0, 0.0524, 1.0, 0, 0, 0], (5, 1))
    with pytest.raises(InputError, match="frames in a row"):
        pose_noise([PoseTrack("x", np.arange(5) / 148, q)], cube)


def test_velocity_noise_counts_a_lag(cube: ObjectModel) -> None:
    rng = np.random.default_rng(3)
    truth = rng.normal(size=(4000, 6))
    phase = np.repeat([Phase.FLIGHT, Phase.REST], 2000).astype(np.uint8)
    recorded = truth + rng.normal(size=truth.shape) * 0.01
    recorded[:2000, 2] += 0.033
    sigma = np.sqrt(np.diagonal(velocity_noise(recorded, truth, phase), axis1=1, axis2=2))
    np.testing.assert_allclose(sigma[Phase.REST], 0.01, rtol=0.1)
    assert 0.03 < sigma[Phase.FLIGHT, 2] < 0.045
    # a phase that does not occur has the noise of all
    assert (sigma[Phase.ROLL] >= 0.009).all()


def test_the_real_cube_is_tracked_to_hundredths_of_a_millimetre(cube: ObjectModel, shared_data: Path) -> None:
    sigma = np.sqrt(np.diag(pose_noise(read_contactnets(shared_data / "contactnets_cube")[::5], cube).q_cov))
    assert (sigma[:3] > 1e-5).all()
    assert (sigma[:3] < 3e-5).all()
    assert (sigma[3:] > 1e-4).all()
    assert (sigma[3:] < 5e-4).all()
