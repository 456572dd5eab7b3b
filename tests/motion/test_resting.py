"""Scatter of resting poses: found where it is, none of noise, none of what all tosses share."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.diagnosis.tossed import seen
from tests.vision.tosses import thrown
from tossid.motion.resting import bounce_heights, other_order, rest_heights, rest_scatter, resting_pose
from tossid.objects import ObjectModel, unstated_object
from tossid.physics.effects import World
from tossid.rotations import quat_exp, quat_mul, quat_rotate, wxyz_to_xyzw, xyzw_to_wxyz
from tossid.settings.motion import RestScatterSettings
from tossid.types import PoseTrack, Toss

SETTINGS = RestScatterSettings()


@pytest.fixture(scope="module")
def tosses(cube: ObjectModel) -> list[Toss]:
    return seen(World(cube, ground_height=2e-3, ground_tilt=(0.01, 0.0)), cube, 24, seed=11, frames=150)


def shifted(toss: Toss, up: float, turn: np.ndarray) -> Toss:
    q = toss.q.copy()
    q[:, 2] += up
    q[:, 3:7] = quat_mul(q[:, 3:7], quat_exp(turn))
    return replace(toss, q=q, q_measured=None, q_measured_cov=None)


def test_noise_and_common_offsets_do_not_count_as_scatter(cube: ObjectModel, tosses: list[Toss]) -> None:
    assert rest_scatter(tosses, cube) == (0.0, 0.0)


def test_a_frame_that_is_off_is_no_scatter(cube: ObjectModel, tosses: list[Toss]) -> None:
    """It puts every side that is down at a height of its own."""
    off = np.array([1.3e-3, 5e-4, -9e-4])
    moved = []
    for toss in tosses:
        q = toss.q.copy()
        q[:, :3] += quat_rotate(q[:, 3:7], off)
        moved.append(replace(toss, q=q, q_measured=None, q_measured_cov=None))
    assert rest_scatter(moved, cube)[0] == 0.0
    assert rest_scatter(moved[: 2 * SETTINGS.fewest_tosses - 1], cube)[0] > 2e-4


def test_scatter_comes_back(cube: ObjectModel, tosses: list[Toss]) -> None:
    rng = np.random.default_rng(0)
    moved = [shifted(toss, 5e-4 * rng.normal(), 8e-3 * rng.normal(size=3)) for toss in tosses]
    height, tilt = rest_scatter(moved, cube)
    assert height == pytest.approx(5e-4, rel=0.6)
    assert tilt == pytest.approx(8e-3, rel=0.6)


def test_over_the_order_scatter_comes_back_and_steps_and_drifts_do_not_count(
    cube: ObjectModel, tosses: list[Toss]
) -> None:
    rng = np.random.default_rng(0)
    moved = [shifted(toss, 5e-4 * rng.normal(), 8e-3 * rng.normal(size=3)) for toss in tosses]
    height, tilt = rest_scatter(moved, cube, over_order=True)
    assert height == pytest.approx(5e-4, rel=0.6)
    assert tilt == pytest.approx(8e-3, rel=0.6)
    for rise in ([3e-3 * (i >= 14) for i in range(24)], [1e-4 * i for i in range(24)]):
        changing = [shifted(toss, up, np.zeros(3)) for toss, up in zip(tosses, rise, strict=True)]
        assert rest_scatter(changing, cube)[0] > 3e-4
        assert rest_scatter(changing, cube, over_order=True)[0] < 1.2e-4


def test_few_resting_tosses_tell_nothing(cube: ObjectModel, tosses: list[Toss]) -> None:
    rng = np.random.default_rng(1)
    moved = [shifted(toss, 5e-3 * rng.normal(), np.zeros(3)) for toss in tosses]
    assert rest_scatter(moved[: SETTINGS.fewest_tosses - 1], cube) == (0.0, 0.0)
    short = [
        replace(
            toss, **{k: getattr(toss, k)[: SETTINGS.frames - 1] for k in ("t", "q", "v", "q_cov", "v_cov", "phase")}
        )
        for toss in tosses
    ]
    assert rest_scatter(short, cube) == (0.0, 0.0)


def _tracks(model: ObjectModel, count: int, *, seed: int, up: float = 0.0, noise: float = 0.0) -> list[PoseTrack]:
    rng, found = np.random.default_rng(seed), []
    for i in range(count):
        toss = thrown(model, rng, name=str(i))
        q = toss.q.copy()
        q[:, 2] += up
        q[:, :3] += rng.normal(size=(len(q), 3)) * noise
        found.append(PoseTrack(str(i), toss.t, q))
    return found


def _reordered(tracks: list[PoseTrack], order) -> list[PoseTrack]:
    return [
        replace(track, q=np.concatenate([track.q[:, :3], order(track.q[:, 3:7]), track.q[:, 7:]], axis=1))
        for track in tracks
    ]


@pytest.fixture(scope="module")
def thrown_cubes(cube: ObjectModel) -> list[PoseTrack]:
    return _tracks(cube, 12, seed=5)


@pytest.mark.parametrize(("wrong", "right"), [(xyzw_to_wxyz, "qw qx qy qz"), (wxyz_to_xyzw, "qx qy qz qw")])
def test_rests_show_the_order_of_quaternions(
    cube: ObjectModel, thrown_cubes: list[PoseTrack], wrong, right: str
) -> None:
    """Columns w x y z that are read as x y z w make w of what was z."""
    w_first = right != "qw qx qy qz"
    for model in (cube, unstated_object()):
        assert other_order(thrown_cubes, model, w_first=w_first) is None
        reordered = _reordered(thrown_cubes, wrong)
        found = other_order(reordered, model, w_first=w_first)
        assert found is not None
        assert (found.name, found.rests) == (right, 12)
        assert found.flat >= 9 > 1.5 * found.as_read


@pytest.mark.parametrize("count", [1, 3])
def test_few_tosses_show_it_too(cube: ObjectModel, thrown_cubes: list[PoseTrack], count: int) -> None:
    told = [
        other_order(_reordered(thrown_cubes[first : first + count], xyzw_to_wxyz), cube, w_first=False) is not None
        for first in range(0, 12, count)
    ]
    assert np.mean(told) >= (0.4 if count == 1 else 0.7)  # two fifths of single rests lie flat in both orders
    assert not any(other_order(thrown_cubes[i : i + count], cube, w_first=False) for i in range(0, 12, count))


def test_links_show_it_too(elbow: ObjectModel) -> None:
    tracks = _tracks(elbow, 6, seed=2)
    assert other_order(tracks, elbow, w_first=False) is None
    found = other_order(_reordered(tracks, xyzw_to_wxyz), elbow, w_first=False)
    assert found is not None
    assert found.name == "qw qx qy qz"


@pytest.mark.parametrize("up", [0.72, 0.03, -0.4])
def test_the_height_of_the_ground_is_that_of_rests_and_bounces(cube: ObjectModel, up: float) -> None:
    tracks = _tracks(cube, 5, seed=8, up=up, noise=5e-4)
    assert rest_heights(tracks, cube) == pytest.approx(np.full(5, up), abs=1.5e-3)
    bounces = bounce_heights(tracks, cube)
    assert len(bounces)
    assert np.median(bounces) == pytest.approx(up, abs=0.02)
    flying = [PoseTrack(track.name, track.t[:20], track.q[:20]) for track in tracks]
    assert not len(rest_heights(flying, cube))
    assert all(resting_pose(track) is None for track in flying)
