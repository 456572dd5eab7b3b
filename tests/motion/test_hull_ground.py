"""The ground under an object of unknown shape."""

from __future__ import annotations

import numpy as np
import pytest

from tests.models.made import tosses
from tests.objects.test_convex_shape import OFFSET, WEDGE, rolled
from tossid.motion.hull_ground import level_by_hull
from tossid.motion.sessions.levelling import turned_track
from tossid.objects import ObjectModel, unstated_object
from tossid.objects.roundness import directions, ellipsoid
from tossid.objects.unstated import hinge_of
from tossid.rotations import quat_exp
from tossid.types import PoseTrack


def tracks_of(points: np.ndarray, tosses: int = 14) -> list[PoseTrack]:
    return [PoseTrack(toss.name, toss.t, toss.q) for toss in rolled(points, np.random.default_rng(3), tosses=tosses)]


@pytest.mark.parametrize(("tilt", "lift"), [((0.03, -0.02), 0.0), ((0.0, 0.0), 0.012), ((0.05, 0.03), -0.02)])
def test_a_tilted_and_shifted_ground_is_levelled(tilt: tuple[float, float], lift: float) -> None:
    level = tracks_of(WEDGE + OFFSET)
    moved = [turned_track(track, quat_exp(np.array([*tilt, 0.0])), lift) for track in level]
    found, ground = level_by_hull(moved)
    assert ground is not None
    off = np.concatenate([a.q[:, 2] - b.q[:, 2] for a, b in zip(found, level, strict=True)])
    assert np.abs(off).max() < 4e-3  # lower heights are left, as they are also what rounded edges look like
    assert np.ptp(off) < 1.5e-3


def test_a_level_ground_is_left_alone() -> None:
    tracks = tracks_of(WEDGE + OFFSET)
    found, ground = level_by_hull(tracks)
    assert ground is None
    assert found is tracks


def test_a_round_object_is_not_taken_for_a_higher_ground() -> None:
    surface = ellipsoid([0.06, 0.045, 0.035]).offset(directions(800)[:, None])[:, 0]
    tracks = tracks_of(surface)
    assert level_by_hull(tracks)[0] is tracks


@pytest.mark.slow
def test_links_share_a_tilted_ground(elbow: ObjectModel) -> None:
    made = tosses(elbow, 30, seed=3, frames=80)
    level = [PoseTrack(toss.name, toss.t, toss.q) for toss in made]
    moved = [turned_track(track, quat_exp(np.array([0.03, -0.02, 0.0])), 0.0) for track in level]
    found, ground = level_by_hull(moved, tree=unstated_object(hinge=hinge_of(elbow)))
    assert ground is not None
    assert np.hypot(*ground[1:]) == pytest.approx(np.hypot(0.03, 0.02), abs=2e-3)
    for track, known in zip(found, level, strict=True):
        assert track.q[:, 2] == pytest.approx(known.q[:, 2], abs=4e-3)
