"""Frames that are lost at impacts are found, and times become the true ones; where none are lost, none are found."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import tossid
from tests.motion.bounced import Bounced, bounced, without
from tossid.motion.sessions.lost_frames import find_lost_frames, lost_words
from tossid.objects import ObjectModel
from tossid.rotations import quat_exp, quat_mul
from tossid.settings.synthesis import LcpEngine, MujocoEngine, NoiseSettings, ReleaseSettings
from tossid.types import PoseTrack

TOSSES, NOISE = 24, 1e-4


def drawn(model: ObjectModel, seed: int, *, planar: bool = False) -> list[Bounced]:
    rng = np.random.default_rng(seed)
    return [bounced(model, rng, name=str(i), noise=NOISE, planar=planar) for i in range(TOSSES)]


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("planar", [False, True])
def test_lost_frames_are_found_and_mended_to_the_true_times(cube: ObjectModel, seed: int, planar: bool) -> None:
    """The frame before the impact, one of the two after it, or two of these; of some tosses none."""
    rng, tracks, times, lost = np.random.default_rng(100 + seed), [], {}, {}
    for i, toss in enumerate(drawn(cube, seed, planar=planar)):
        count = (1, 1, 0, 2)[i % 4]
        at = toss.last + int(rng.integers(0, 2))
        track, times[str(i)] = without(toss.track, list(range(at, at + count)))
        lost[str(i)] = count
        tracks.append(track)
    found = find_lost_frames(tracks, cube)
    judged = {i.toss: i for i in found.impacts if i.lost is not None}
    assert {name: i.lost for name, i in judged.items()} == {name: lost[name] for name in judged}
    assert len(judged) > (0.6 if planar else 0.9) * TOSSES
    assert found.first.is_lossy
    assert found.unjudged == set(times) - set(judged)
    for track in found.mended(tracks):
        if track.name in judged:
            np.testing.assert_allclose(track.t, times[track.name], atol=1e-9)
            skip = judged[track.name].skip / judged[track.name].frame_time
            assert skip == pytest.approx(lost[track.name], abs=0.3)


@pytest.mark.parametrize("seed", range(6))
def test_whole_recordings_lost_nothing(cube: ObjectModel, seed: int) -> None:
    tracks = [toss.track for toss in drawn(cube, seed)]
    found = find_lost_frames(tracks, cube)
    assert found.first.counts[0] > 0.9 * TOSSES
    assert found.first.counts[1:] == (0, 0, 0)
    assert lost_words(found) is None
    assert found.mended(tracks) is tracks
    assert not found.unjudged


def test_bodies_that_tumble_are_judged_too(cube: ObjectModel) -> None:
    """With a constant spin in place of Euler's equations, flights of a twentieth of a second do not meet."""
    slab = cube.with_changes(inertia=cube.inertia * np.diag([1.0, 1.4, 0.6]))
    tosses = drawn(slab, 3)
    tracks = [without(toss.track, [toss.last + 1])[0] for toss in tosses]
    assert find_lost_frames(tracks, slab).first.counts[1] > 0.8 * TOSSES
    assert find_lost_frames(tracks, cube).first.counts[1] < 0.5 * TOSSES


def test_times_that_show_the_gap_are_true(cube: ObjectModel) -> None:
    tracks = []
    for toss in drawn(cube, 1):
        track, true = without(toss.track, [toss.last + 1])
        tracks.append(replace(track, t=true))
    found = find_lost_frames(tracks, cube)
    assert found.first.counts[0] > 0.9 * TOSSES
    assert not found.losses


def test_frames_too_many_are_the_measure_of_chance(cube: ObjectModel) -> None:
    """Half of the tosses lost a frame, half have one too many: that is no sign of loss."""
    tracks = []
    for i, toss in enumerate(drawn(cube, 2)):
        t, q, at = toss.track.t, toss.track.q, toss.last + 1
        if i % 2:
            tracks.append(without(toss.track, [at])[0])
        else:
            tracks.append(PoseTrack(str(i), np.append(t, t[-1] + t[1]), np.insert(q, at, q[at], axis=0)))
    found = find_lost_frames(tracks, cube)
    assert min(found.first.counts[1], found.first.chance) > 0.35 * TOSSES
    assert not found.first.is_lossy
    assert not found.losses
    few = find_lost_frames(tracks[1:10:2], cube)  # five losses, which chance makes in one of 32 recordings
    assert few.first.counts[1] > 3
    assert not few.first.is_lossy


def test_a_wrong_pose_in_the_air_is_no_impact(cube: ObjectModel) -> None:
    tracks = []
    for toss in drawn(cube, 4):
        q = toss.track.q.copy()
        q[2, :3] += 0.02
        q[2, 3:7] = quat_mul(q[2, 3:7], quat_exp([0.0, 0.3, 0.0]))
        tracks.append(without(replace(toss.track, q=q), [toss.last + 1])[0])
    found = find_lost_frames(tracks, cube)
    assert found.first.impacts == TOSSES
    assert found.later.impacts == 0
    assert found.first.counts[1] > 0.9 * TOSSES


def test_recorded_velocities_are_left_out_of_all_tracks(cube: ObjectModel) -> None:
    tosses = drawn(cube, 5)
    tracks = [without(t.track, [t.last + 1])[0] if i else t.track for i, t in enumerate(tosses)]
    tracks = [replace(track, v=np.zeros((len(track.t), 6))) for track in tracks]
    mended = find_lost_frames(tracks, cube).mended(tracks)
    assert [track.v for track in mended] == [None] * TOSSES
    np.testing.assert_array_equal(mended[0].t, tracks[0].t)


def test_tosses_without_flight_after_their_impact_cannot_be_judged(cube: ObjectModel) -> None:
    rng = np.random.default_rng(6)
    tosses = [bounced(cube, rng, name=f"s{i}", before=12 if i % 2 else 3, after=4) for i in range(6)]
    found = find_lost_frames([toss.track for toss in tosses], cube)
    assert [i.lost for i in found.impacts] == [None] * len(found.impacts)
    assert found.first.impacts == 6
    for frames in range(2, 8):
        assert find_lost_frames([tosses[1].track.frames(slice(frames))], cube).impacts == ()


@pytest.mark.parametrize(
    ("engine", "effects"),
    [
        (LcpEngine(), {}),
        (LcpEngine(), {"restitution": {"e": 0.3}}),
        (LcpEngine(), {"restitution": {"e": 0.6}}),
        (LcpEngine(), {"compliance": {"stiffness_npm": 2e4, "damping_nspm": 15.0}}),
        (MujocoEngine(), {}),
        (MujocoEngine(soft=True), {}),
    ],
)
@pytest.mark.filterwarnings("ignore:the contact problem missed")
def test_impacts_that_take_time_or_come_in_pairs_are_no_lost_frames(
    cube: ObjectModel, engine: LcpEngine | MujocoEngine, effects: dict[str, dict[str, float]]
) -> None:
    made = tossid.synthesize(
        cube,
        tosses=TOSSES,
        engine=engine,
        effects=effects,
        release=ReleaseSettings(height=(0.2, 0.6), spin=(0.0, 15.0)),
        noise=NoiseSettings(position=1.5e-4, rotation=1.5e-3),
        seconds=0.8,
    )
    found = find_lost_frames([PoseTrack(toss.name, toss.t, toss.q) for toss in made.tosses], cube)
    assert found.first.impacts >= TOSSES - 2
    for verdict in (found.first, found.later):
        assert sum(verdict.counts[1:]) + verdict.chance <= 1
        assert not verdict.is_lossy
    if effects.get("restitution"):
        assert found.later.counts[0] + found.first.counts[0] >= 5


@pytest.mark.parametrize("seed", range(4))
def test_frames_that_are_lost_in_flight_are_found_and_mended(cube: ObjectModel, seed: int) -> None:
    """One or two frames in the middle of a flight, and a jump of the tracker, which is no loss."""
    rng, tracks, times = np.random.default_rng(200 + seed), [], {}
    for i in range(TOSSES):
        whole = bounced(cube, rng, name=str(i), noise=NOISE, before=26).track
        if i % 4 == 3:
            q = whole.q.copy()
            q[12:, 0] += 0.03
            tracks.append(replace(whole, q=q))
        else:
            track, times[str(i)] = without(whole, [12, 13][: 1 + i % 2])
            tracks.append(track)
    found = find_lost_frames(tracks, cube)
    assert found.in_flight.is_lossy
    lost = {impact.toss for impact in found.losses if impact.in_flight}
    assert len(lost) > 0.9 * len(times)
    assert lost <= set(times)
    assert not found.unjudged
    for track in found.mended(tracks):
        if track.name in lost:
            np.testing.assert_allclose(track.t, times[track.name], atol=1e-9)
