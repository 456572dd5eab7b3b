"""Tracks become tosses, whatever they carry: noise, phases, velocities."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.motion.bouncing import bounce, tracked
from tossid.errors import InputError, MotionError
from tossid.motion import (
    covariance_source,
    label_phases,
    median_rate,
    tosses_from_tracks,
    tosses_in_turn,
)
from tossid.motion.noise import pose_noise, scatter, velocity_noise
from tossid.motion.smoothing import smoother
from tossid.objects import ObjectModel
from tossid.rotations import quat_exp, quat_mul
from tossid.store import read_contactnets
from tossid.types import OnDemand, Phase, PoseTrack

H = 1 / 148
HALF = 0.0524

# noise


@pytest.mark.parametrize(("position", "rotation"), [(0.15e-3, 1.5e-3), (0.02e-3, 0.3e-3), (1e-3, 10e-3)])
def test_known_noise_is_recovered_whatever_glitches(cube: ObjectModel, position: float, rotation: float) -> None:
    rng = np.random.default_rng(0)
    truths = bounce(cube, rng, tosses=20, frames=50)
    tracks = [tracked(x, rng, position=position, rotation=rotation, with_cov=False) for x in truths]
    found = pose_noise(tracks, cube)
    np.testing.assert_allclose(np.sqrt(np.diag(found)), [position] * 3 + [rotation] * 3, rtol=0.2)
    for track in tracks[::3]:
        track.q[8, :3] += 0.02
    np.testing.assert_allclose(np.sqrt(np.diag(pose_noise(tracks, cube)))[:3], position, rtol=0.4)
    noise = 1e-4 * rng.normal(size=(4000, 3))
    assert scatter(np.diff(noise, n=3, axis=0)) == pytest.approx(1e-4, rel=0.05)


def test_without_flight_the_quiet_half_serves_and_too_short_a_track_is_refused(cube: ObjectModel) -> None:
    q = np.tile([0, 0, HALF, 1.0, 0, 0, 0], (100, 1))
    q[:, :3] += np.random.default_rng(2).normal(size=(100, 3)) * 1e-4
    found = pose_noise([PoseTrack("x", np.arange(100) * H, q)], cube)
    np.testing.assert_allclose(np.sqrt(np.diag(found))[:3], 1e-4, rtol=0.5)
    with pytest.raises(InputError, match="frames in a row"):
        pose_noise([PoseTrack("x", np.arange(5) * H, q[:5])], cube)


def test_velocity_noise_counts_a_lag() -> None:
    rng = np.random.default_rng(3)
    truth = rng.normal(size=(4000, 6))
    phase = np.repeat([Phase.FLIGHT, Phase.REST], 2000).astype(np.uint8)
    recorded = truth + rng.normal(size=truth.shape) * 0.01
    recorded[:2000, 2] += 0.033
    sigma = np.sqrt(np.diagonal(velocity_noise(recorded, truth, phase), axis1=1, axis2=2))
    np.testing.assert_allclose(sigma[Phase.REST], 0.01, rtol=0.1)
    assert 0.03 < sigma[Phase.FLIGHT, 2] < 0.045
    assert (sigma[Phase.ROLL] >= 0.009).all()  # a phase that does not occur has the noise of all


# phases

Motion = tuple[np.ndarray, np.ndarray, np.ndarray]


def still(n: int, height: float) -> Motion:
    q = np.zeros((n, 7))
    q[:, 2], q[:, 3] = height, 1.0
    return np.arange(n) * H, q, np.zeros((n, 6))


def thrown() -> Motion:
    t, q, v = still(30, 0.5)
    v[:] = [1.0, 0.5, 1.0, 3.0, -2.0, 8.0]
    v[:, 2] -= 9.81 * t
    q[:, :3] += np.array([1.0, 0.5, 1.0]) * t[:, None]
    q[:, 2] -= 4.905 * t**2
    q[:, 3:7] = quat_exp(v[:, 3:] * t[:, None])
    return t, q, v


def tipping() -> Motion:
    """About the edge at x = +half, z = 0, at 2 rad/s."""
    t, q, v = still(25, HALF)
    q[:, 3:7] = quat_exp(np.array([0.0, 2.0, 0.0]) * t[:, None])
    c, s = np.cos(2 * t), np.sin(2 * t)
    q[:, 0], q[:, 2] = HALF * (1 - c + s), HALF * (s + c)
    v[:, 4] = 2.0
    v[:, 0], v[:, 2] = 2.0 * q[:, 2], -2.0 * (q[:, 0] - HALF)
    return t, q, v


def spinning() -> Motion:
    t, q, v = still(25, HALF)
    v[:, 5] = 3.0
    q[:, 3:7] = quat_exp(v[:, 3:] * t[:, None])
    return t, q, v


def pushed_in_the_air() -> Motion:
    t, q, v = still(10, 1.0)
    v[:, 2] = -9.81 * t
    v[5:, 0] = 1.0
    return t, q, v


@pytest.mark.parametrize(
    ("motion", "phase"),
    [
        (thrown(), Phase.FLIGHT),
        (pushed_in_the_air(), Phase.FLIGHT),
        (still(20, HALF), Phase.REST),
        (tipping(), Phase.ROLL),
        (spinning(), Phase.SLIDE),
    ],
)
def test_motions_of_one_phase(cube: ObjectModel, motion: Motion, phase: Phase) -> None:
    assert (label_phases(cube, *motion) == phase).all()


def test_a_braking_cube_slides_then_rests_and_a_dropped_one_meets_the_ground_once(cube: ObjectModel) -> None:
    t, q, v = still(120, HALF)
    v[:, 0] = np.maximum(1.0 - 0.18 * 9.81 * t, 0.0)
    q[1:, 0] = np.cumsum(v[1:, 0]) * H
    stop = int(np.argmax(v[:, 0] <= 0.05))
    assert label_phases(cube, t, q, v).tolist() == [Phase.SLIDE] * stop + [Phase.REST] * (120 - stop)
    t, q, v = still(60, HALF)
    flying = t < np.sqrt(2 * 0.1 / 9.81)
    v[flying, 2] = -9.81 * t[flying]
    q[flying, 2] += 0.1 - 4.905 * t[flying] ** 2
    hit = int(np.argmin(flying))
    expected = [Phase.FLIGHT] * hit + [Phase.IMPACT] + [Phase.REST] * (59 - hit)
    assert label_phases(cube, t, q, v).tolist() == expected


def test_impacts_of_bouncing_cubes_are_found_whichever_way_they_look(cube: ObjectModel) -> None:
    found = flights = 0
    turn, c, s = quat_exp(np.array([0.0, 0.0, 0.7])), np.cos(0.7), np.sin(0.7)
    Z = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1.0]])
    for truth in bounce(cube, np.random.default_rng(0), tosses=8, frames=80):
        phase = label_phases(cube, truth.t, truth.q, truth.v)
        step = np.diff(truth.v[:, :3], axis=0) + np.array([0, 0, 9.81 * H])
        hard = np.linalg.norm(step, axis=1) > 0.3
        assert (phase[1:][hard] == Phase.IMPACT).all()
        assert not (phase[1:][~truth.contact] == Phase.IMPACT).any()
        first = int(np.argmax(truth.contact))
        assert (phase[: first + 1] == Phase.FLIGHT).all()
        found, flights = found + int(hard.sum()), flights + first
        q = np.column_stack([truth.q[:, :3] @ Z.T, quat_mul(turn, truth.q[:, 3:7])])
        v = np.column_stack([truth.v[:, :3] @ Z.T, truth.v[:, 3:]])
        np.testing.assert_array_equal(label_phases(cube, truth.t, q, v), phase)
    assert (found > 15, flights > 100) == (True, True)


def test_noise_is_not_taken_for_impacts_and_no_motion_is_refused(cube: ObjectModel) -> None:
    t, q, v = still(200, HALF)
    v += np.random.default_rng(0).normal(size=v.shape) * 0.1 * np.array([1, 1, 1, 20, 20, 20])
    assert (label_phases(cube, t, q, v) == Phase.IMPACT).any()
    assert not (label_phases(cube, t, q, v, v_sigma=0.24) == Phase.IMPACT).any()
    q[2, 0] = np.nan
    with pytest.raises(MotionError, match="finite"):
        label_phases(cube, t, q, v)


# tosses


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


def test_recorded_velocities_and_given_covariances_are_kept(cube: ObjectModel, tracks: list[PoseTrack]) -> None:
    v = [np.concatenate([np.diff(track.q[:, :6], axis=0), np.zeros((1, 6))]) for track in tracks]
    carrying = [replace(track, v=velocity) for track, velocity in zip(tracks, v, strict=True)]
    for toss, track in zip(tosses_from_tracks(carrying, cube), carrying, strict=True):
        np.testing.assert_array_equal(toss.v, track.v)
        np.testing.assert_array_equal(toss.q, track.q)
    assert "by phase" in covariance_source(carrying)
    rng = np.random.default_rng(1)
    track = tracked(bounce(cube, rng, tosses=1, frames=60)[0], rng)
    (sure,), (vague,) = (tosses_from_tracks([each], cube) for each in (track, replace(track, q_cov=25 * track.q_cov)))
    assert vague.v_cov[10, 0, 0] > 4 * sure.v_cov[10, 0, 0]
    assert "given with the track" in covariance_source([track])


def test_a_toss_ends_at_rest(cube: ObjectModel) -> None:
    n, rng = 300, np.random.default_rng(3)
    truth = bounce(cube, rng, tosses=1, frames=40)[0]
    t, lying, _ = still(n, HALF)
    lying[:, 2] += np.maximum(4.905 * (0.2**2 - t**2), 0.0)
    lying[:, :3] += rng.normal(size=(n, 3)) * 2e-5
    tracks = [PoseTrack("a", t, lying), tracked(truth, rng, name="b", with_cov=False)]
    whole, ended = (tosses_from_tracks(tracks, cube, end_at_rest=cut) for cut in (False, True))
    assert len(whole[0]) == n
    assert 0.28 < ended[0].t[-1] < 0.36
    assert len(ended[1]) == len(whole[1])


@pytest.mark.parametrize(
    ("spoil", "match"),
    [
        (lambda track: [replace(track, q=np.concatenate([track.q, track.q[:, :1]], axis=1))], "1 joints"),
        (lambda track: [replace(track, q=track.q - np.array([0, 0, 1.0, 0, 0, 0, 0]))], "below the ground"),
        (lambda track: [replace(track, q=track.q + np.array([0, 0, 1.0, 0, 0, 0, 0]))], "above the ground"),
        (lambda track: [track, replace(track, v=np.zeros((len(track.t), 6)))], "toss_0 carries no velocities"),
        (lambda track: [], "no tracks"),
    ],
)
def test_tracks_that_do_not_fit_are_refused(cube: ObjectModel, tracks: list[PoseTrack], spoil, match: str) -> None:
    with pytest.raises(InputError, match=match):
        tosses_from_tracks([each for track in tracks for each in spoil(track)], cube)


def test_the_real_cube(cube: ObjectModel, shared_data: Path) -> None:
    """Its noise, its phases in their order, and its recorded velocities, which lag by half a frame."""
    every = read_contactnets(shared_data / "contactnets_cube")
    noise = np.sqrt(np.diag(pose_noise(every[::5], cube)))
    assert 1e-5 < noise[:3].min() <= noise[:3].max() < 3e-5
    assert 1e-4 < noise[3:].min() <= noise[3:].max() < 5e-4
    tracks = every[::20]
    tosses = tosses_from_tracks(tracks, cube)
    for toss in tosses:
        assert (toss.phase[0], toss.phase[-1]) == (Phase.FLIGHT, Phase.REST)
        order = [int(np.argmax(toss.phase == p)) for p in (Phase.FLIGHT, Phase.IMPACT, Phase.REST)]
        assert order == sorted(order)
        assert (toss.phase == Phase.SLIDE).mean() > 0.2
    smoothed = tosses_from_tracks([replace(track, v=None) for track in tracks], cube)
    lag = np.median([toss.v[5, 2] for toss in tosses]) - np.median([toss.v[5, 2] for toss in smoothed])
    assert lag == pytest.approx(0.5 * 9.7 / 148, abs=0.006)


@pytest.mark.parametrize("recorded", [False, True])
def test_more_tracks_than_are_kept_come_in_their_order(
    cube: ObjectModel, tracks: list[PoseTrack], recorded: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    rng = np.random.default_rng(4)
    many = [replace(tracks[i % 6], name=f"n{i}") for i in rng.permutation(18)]
    many = [replace(track, t=track.t[: 40 + 2 * i], q=track.q[: 40 + 2 * i]) for i, track in enumerate(many)]
    if recorded:
        many = [replace(track, v=np.gradient(track.q[:, :6], 1 / 148, axis=0)) for track in many]
    at_once = tosses_from_tracks(many, cube)
    monkeypatch.setattr(smoother, "BATCH", 3)
    monkeypatch.setattr(smoother, "SORTED_TRACKS", 5)
    at_once_in_threes = tosses_from_tracks(many, cube)
    read = [0]

    def track(i: int) -> PoseTrack:
        read[0] += 1
        return many[i]

    in_turn = list(tosses_in_turn(OnDemand(track, len(many), kept=6), cube))
    assert read[0] > 2 * len(many)
    assert [toss.name for toss in in_turn] == [track.name for track in many]
    for a, b, c in zip(in_turn, at_once_in_threes, at_once, strict=True):
        np.testing.assert_array_equal(a.v, b.v)
        np.testing.assert_array_equal(a.q_cov, b.q_cov)
        np.testing.assert_allclose(a.q[:, :3], c.q[:, :3], atol=1e-3)  # another sample gives the densities
