"""Tracks become tosses, whatever they carry."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.motion.bouncing import bounce, tracked
from tossid.errors import InputError
from tossid.motion import covariance_source, median_rate, tosses_from_tracks, tosses_in_turn
from tossid.objects import ObjectModel
from tossid.settings.motion import MotionSettings, SmootherSettings
from tossid.store import read_contactnets, read_pll
from tossid.types import OnDemand, Phase, PoseTrack


@pytest.fixture(scope="module")
def tracks(cube: ObjectModel) -> list[PoseTrack]:
    rng = np.random.default_rng(0)
    truths = bounce(cube, rng, tosses=6, frames=70)
    return [tracked(truth, rng, name=f"toss_{i}", with_cov=False) for i, truth in enumerate(truths)]


def test_poses_alone_give_velocities(cube: ObjectModel, tracks: list[PoseTrack]) -> None:
    tosses = tosses_from_tracks(tracks, cube)
    assert [toss.name for toss in tosses] == [track.name for track in tracks]
    for toss, track in zip(tosses, tracks, strict=True):
        np.testing.assert_array_equal(toss.t, track.t)
        np.testing.assert_allclose(toss.q[:, :3], track.q[:, :3], atol=1e-3)
        assert toss.phase[0] == Phase.FLIGHT
        assert (toss.phase == Phase.IMPACT).any()
        assert (np.linalg.eigvalsh(toss.v_cov) > 0).all()
        poses, cov = toss.measured
        np.testing.assert_array_equal(poses, track.q)
        assert (np.diagonal(cov, axis1=1, axis2=2) > np.diagonal(toss.q_cov, axis1=1, axis2=2)).mean() > 0.9
    assert covariance_source(tracks) == "q, v: smoother (measurement: residuals in flight)"
    assert median_rate(tracks) == pytest.approx(148.0)


def test_recorded_velocities_are_kept(cube: ObjectModel, tracks: list[PoseTrack]) -> None:
    v = [np.concatenate([np.diff(track.q[:, :6], axis=0), np.zeros((1, 6))]) for track in tracks]
    carrying = [replace(track, v=velocity) for track, velocity in zip(tracks, v, strict=True)]
    for toss, track in zip(tosses_from_tracks(carrying, cube), carrying, strict=True):
        np.testing.assert_array_equal(toss.v, track.v)
        np.testing.assert_array_equal(toss.q, track.q)
    assert "by phase" in covariance_source(carrying)


def test_a_given_covariance_is_used(cube: ObjectModel) -> None:
    rng = np.random.default_rng(1)
    track = tracked(bounce(cube, rng, tosses=1, frames=60)[0], rng)
    assert track.q_cov is not None
    vague = replace(track, q_cov=25 * track.q_cov)
    a, b = tosses_from_tracks([track], cube)[0], tosses_from_tracks([vague], cube)[0]
    assert (b.v_cov[10, 0, 0] > 4 * a.v_cov[10, 0, 0]).all()
    assert "given with the track" in covariance_source([track])


def test_a_toss_ends_at_rest(cube: ObjectModel) -> None:
    n, rng = 300, np.random.default_rng(3)
    truth = bounce(cube, rng, tosses=1, frames=40)[0]
    lying = np.tile([0.0, 0, 0.0524, 1, 0, 0, 0], (n, 1))
    t = np.arange(n) / 148
    fall = t < 0.2
    lying[fall, 2] += 4.905 * (0.2**2 - t[fall] ** 2)
    lying[:, :3] += rng.normal(size=(n, 3)) * 2e-5
    tracks = [PoseTrack("a", t, lying), tracked(truth, rng, name="b", with_cov=False)]
    whole = tosses_from_tracks(tracks, cube)
    ended = tosses_from_tracks(tracks, cube, end_at_rest=True)
    assert len(whole[0]) == n
    assert 0.28 < ended[0].t[-1] < 0.36
    assert len(ended[1]) == len(whole[1])


@pytest.mark.parametrize(
    ("spoil", "says"),
    [
        (lambda track: replace(track, q=np.concatenate([track.q, track.q[:, :1]], axis=1)), "1 joints"),
        (lambda track: replace(track, q=track.q - np.array([0, 0, 1.0, 0, 0, 0, 0])), "below the ground"),
        (lambda track: replace(track, q=track.q + np.array([0, 0, 1.0, 0, 0, 0, 0])), "above the ground"),
    ],
)
def test_tracks_that_do_not_fit_are_refused(cube: ObjectModel, tracks: list[PoseTrack], spoil, says: str) -> None:
    with pytest.raises(InputError, match=says):
        tosses_from_tracks([spoil(track) for track in tracks], cube)


def test_mixed_tracks_are_refused(cube: ObjectModel, tracks: list[PoseTrack]) -> None:
    some = [tracks[0], replace(tracks[1], v=np.zeros((len(tracks[1].t), 6)))]
    with pytest.raises(InputError, match="toss_0 carries no velocities"):
        tosses_from_tracks(some, cube)
    with pytest.raises(InputError, match="no tracks"):
        tosses_from_tracks([], cube)


def test_the_real_cube(cube: ObjectModel, shared_data: Path) -> None:
    tracks = read_contactnets(shared_data / "contactnets_cube")[::20]
    tosses = tosses_from_tracks(tracks, cube)
    phase = np.concatenate([toss.phase for toss in tosses])
    v_cov = np.concatenate([toss.v_cov for toss in tosses])
    sigma = {p: np.sqrt(np.diag(v_cov[phase == p][0])) for p in (Phase.FLIGHT, Phase.IMPACT, Phase.REST)}
    # recorded velocities lag by half a frame: g/2/148 = 33 mm/s in flight
    assert 0.025 < sigma[Phase.FLIGHT][2] < 0.045
    assert sigma[Phase.REST][2] < 0.01
    assert sigma[Phase.IMPACT][2] > 3 * sigma[Phase.FLIGHT][2]
    smoothed = tosses_from_tracks([replace(track, v=None) for track in tracks], cube)
    lag = np.median([toss.v[5, 2] for toss in tosses]) - np.median([toss.v[5, 2] for toss in smoothed])
    assert lag == pytest.approx(0.5 * 9.7 / 148, abs=0.006)


def test_the_real_elbow(elbow: ObjectModel, shared_data: Path) -> None:
    tracks = read_pll(shared_data / "pll_elbow", n_joints=1)[::30]
    tosses = tosses_from_tracks(tracks, elbow)
    assert all(toss.v.shape == (121, 7) for toss in tosses)
    phase = np.concatenate([toss.phase for toss in tosses])
    assert {Phase.FLIGHT, Phase.IMPACT, Phase.REST} <= set(phase.tolist())


@pytest.mark.parametrize("recorded", [False, True])
def test_more_tracks_than_are_kept_come_in_their_order(
    cube: ObjectModel, tracks: list[PoseTrack], recorded: bool
) -> None:
    rng = np.random.default_rng(4)
    many = [replace(tracks[i % 6], name=f"n{i}") for i in rng.permutation(18)]
    many = [replace(track, t=track.t[: 40 + 2 * i], q=track.q[: 40 + 2 * i]) for i, track in enumerate(many)]
    if recorded:
        many = [replace(track, v=np.gradient(track.q[:, :6], 1 / 148, axis=0)) for track in many]
    at_once = tosses_from_tracks(many, cube)
    small = MotionSettings(smoother=SmootherSettings(batch=3, sorted_tracks=5))
    at_once_in_threes = tosses_from_tracks(many, cube, settings=small)
    read = [0]

    def track(i: int) -> PoseTrack:
        read[0] += 1
        return many[i]

    in_turn = list(tosses_in_turn(OnDemand(track, len(many), kept=6), cube, settings=small))
    assert read[0] > 2 * len(many)
    assert [toss.name for toss in in_turn] == [track.name for track in many]
    for a, b, c in zip(in_turn, at_once_in_threes, at_once, strict=True):
        np.testing.assert_array_equal(a.v, b.v)
        np.testing.assert_array_equal(a.q_cov, b.q_cov)
        np.testing.assert_allclose(a.q[:, :3], c.q[:, :3], atol=1e-3)  # another sample gives the densities
