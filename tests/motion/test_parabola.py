"""Flight of a body of which nothing is known."""

from __future__ import annotations

import numpy as np
import pytest

from tests.models.made import tosses
from tossid.errors import InputError
from tossid.motion.parabola import find_parabola, phases_of_motion
from tossid.objects import ObjectModel, corner_positions
from tossid.rotations import quat_exp, quat_mul
from tossid.types import Phase, PoseTrack

OFF = np.array([0.01, -0.03, 0.02])


@pytest.fixture(scope="module")
def shifted(cube: ObjectModel) -> ObjectModel:
    """A cube whose recorded frame is off its centre of mass."""
    return cube.with_changes(corner_pos=cube.corner_pos + OFF, com=cube.com + OFF)


@pytest.fixture(scope="module")
def tracks(shifted: ObjectModel) -> list[PoseTrack]:
    rng, found = np.random.default_rng(0), []
    for toss in tosses(shifted, 12, seed=2, frames=100, substeps=4):
        q = toss.q.copy()
        q[:, :3] += 1.5e-4 * rng.normal(size=(len(q), 3))
        q[:, 3:7] = quat_mul(q[:, 3:7], quat_exp(1e-3 * rng.normal(size=(len(q), 3))))
        found.append(PoseTrack(toss.name, toss.t, q))
    return found


def test_the_centre_of_mass_is_what_falls(tracks: list[PoseTrack]) -> None:
    found = find_parabola(tracks)
    assert found.com[0] == pytest.approx(OFF, abs=1e-3)
    assert 0.01 < found.gyration < 0.06


def test_flight_is_where_nothing_touches(tracks: list[PoseTrack], shifted: ObjectModel) -> None:
    found = find_parabola(tracks)
    low = np.concatenate([corner_positions(shifted, track.q)[..., 2].min(axis=1) for track in tracks])
    flying = np.concatenate([found.flying(track.t, track.q) for track in tracks])
    assert flying[low > 0.03].mean() > 0.9  # frames between two impacts may be too few for a parabola
    assert flying[low < 1e-3].mean() < 0.2


def test_phases_are_flight_impact_and_rest(shifted: ObjectModel) -> None:
    (toss,) = tosses(shifted, 1, seed=4, frames=220, substeps=4)
    found = find_parabola([PoseTrack(toss.name, toss.t, toss.q)])
    phase = phases_of_motion(found, toss.t, toss.q, toss.v)
    assert phase[2] == Phase.FLIGHT
    assert (phase == Phase.IMPACT).any()
    assert phase[-1] == Phase.REST
    assert not np.isin(phase, (Phase.SLIDE, Phase.ROLL)).any()


def test_what_only_rests_or_slides_does_not_fly() -> None:
    t = np.arange(100) / 148
    q = np.zeros((100, 7))
    q[:, 2], q[:, 3], q[:, 0] = 0.05, 1.0, 0.4 * t
    with pytest.raises(InputError, match="no flight"):
        find_parabola([PoseTrack("slide", t, q)])


def test_joints_are_refused() -> None:
    t = np.arange(30) / 148
    q = np.zeros((30, 8))
    q[:, 3] = 1.0
    with pytest.raises(InputError, match="one rigid body"):
        find_parabola([PoseTrack("jointed", t, q)])
