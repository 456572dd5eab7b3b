"""Tosses that a smoother made, whose times or lengths are wrong, or that lost frames: told from sound ones."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter1d

import tossid
from tests.motion.bounced import bounced, without
from tests.motion.bouncing import bounce
from tests.motion.handling import Handling
from tossid.motion.segmentation import segment
from tossid.motion.sessions.falls import WHITE, fall_words, look_for_smoothing, rate_words
from tossid.motion.sessions.lost_frames import find_lost_frames, lost_words
from tossid.objects import ObjectModel, load_object
from tossid.rotations import quat_exp, quat_mul
from tossid.settings.segmentation import SegmentSettings
from tossid.settings.synthesis import LcpEngine, MujocoEngine, NoiseSettings, ReleaseSettings
from tossid.store.importers import read_contactnets, read_pll, read_tum
from tossid.types import LongTrack, PoseTrack

# made by a smoother


def over_time(tracks: list[PoseTrack], sigma: float, every: int = 1) -> list[PoseTrack]:
    """Every so manieth frame, with positions through a Gaussian filter of so many of these."""
    out = []
    for track in tracks:
        q = track.q[::every].copy()
        if sigma:
            q[:, :3] = gaussian_filter1d(q[:, :3], sigma, axis=0, mode="nearest")
        out.append(PoseTrack(track.name, track.t[::every], q))
    return out


@pytest.mark.parametrize(
    ("every", "sigma", "smoothed"), [(1, 0.0, False), (5, 0.0, False), (1, 15.0, True), (5, 3.0, True), (1, 2.0, False)]
)
def test_what_a_smoother_made_is_told_from_what_was_measured(
    cube_tracks: list[PoseTrack], cube: ObjectModel, every: int, sigma: float, smoothed: bool
) -> None:
    """A filter over 0.1 s bends flights, which last 0.25 s, into contact; a light one is no reason."""
    seen = look_for_smoothing(over_time(cube_tracks, sigma, every), cube)
    assert (seen.falls, seen.smoothed) == (not smoothed, smoothed)
    if sigma:
        assert seen.roughness < (0.8 if smoothed else 1.0)
    else:
        assert (seen.n_falls, seen.fall_error < 0.5) == (40, True)
        assert every > 1 or seen.roughness == pytest.approx(WHITE, abs=0.15)


@pytest.mark.parametrize("gravity", [3.7, 9.81])
def test_simulated_tosses_without_noise_are_not_taken_for_smoothed(cube: ObjectModel, gravity: float) -> None:
    """Not under another gravity than is stated either: then they do not fall by that one, and that is all."""
    for rate in (30, 500):
        times = np.round(np.arange(rate) / rate / 5e-4) * 5e-4
        truths = bounce(cube, np.random.default_rng(1), tosses=6, frames=rate, times=times, gravity=gravity)
        seen = look_for_smoothing([PoseTrack(str(i), one.t, one.q) for i, one in enumerate(truths)], cube)
        assert (seen.falls, seen.smoothed) == (gravity == 9.81, False)
        assert seen.fall_error == pytest.approx(9.81 - gravity, abs=1e-6)


def test_too_little_to_judge_is_no_reason(cube_tracks: list[PoseTrack], cube: ObjectModel) -> None:
    t = np.arange(100) / 100
    q = np.zeros((100, 7))
    q[:, 3], q[:, 0] = 1.0, 0.3 * np.sin(3 * t)
    short = [track.frames(slice(n)) for track in cube_tracks[:3] for n in (2, 3, 4)]
    for tracks in ([PoseTrack(str(i), t, q.copy()) for i in range(5)], short):  # pushed only; of few frames
        seen = look_for_smoothing(tracks, cube)
        assert (seen.n_falls, seen.falls, seen.smoothed) == (0, True, False)
    smooth = over_time(cube_tracks[:2], 15.0)
    assert look_for_smoothing(smooth[:1], cube).falls
    assert not look_for_smoothing(smooth, cube).falls


def test_published_recordings_were_measured_but_for_the_milk_carton_and_the_egg(
    shared_data: Path, cube: ObjectModel
) -> None:
    die = shared_data / "mit_die"
    measured = [
        look_for_smoothing(read_contactnets(shared_data / "contactnets_cube"), cube),
        look_for_smoothing(read_pll(shared_data / "pll_elbow", n_joints=1), load_object("elbow")),
        look_for_smoothing(read_tum(die / "measured", n_joints=0), load_object(die / "die.xml")),
        look_for_smoothing(read_tum(shared_data / "basketball", n_joints=0), cube),
    ]
    for seen in measured:
        assert seen.fall_error < 0.6
        assert seen.n_falls >= 12
        assert not seen.roughness < 1.5  # the basketball has too few frames in a row
        assert (seen.falls, seen.smoothed) == (True, False)
    for name in ("milk", "egg"):
        tracks = read_tum(shared_data / "smoothed_30hz" / name, n_joints=0)
        for some in (tracks, [tracks[i] for i in range(1, 10, 2)]):
            seen = look_for_smoothing(some, cube)
            assert (seen.fall_error > 1.5, seen.roughness < 0.8, seen.smoothed) == (True, True, True)


# wrong times or lengths


@pytest.fixture(scope="module")
def film(cube: ObjectModel) -> PoseTrack:
    rng = np.random.default_rng(0)
    return Handling(cube, rng).recording(15.0).tracked(rng)


def _number(words: str | None, pattern: str) -> float:
    found = re.search(pattern, words or "")
    assert found, words
    return float(found[1])


@pytest.mark.parametrize("factor", [0.85, 1.0, 1.03, 1.1, 1.3])
def test_times_that_are_wrong_a_little_are_named_by_the_rate(cube: ObjectModel, film: PoseTrack, factor: float) -> None:
    tosses, _ = segment(replace(film, t=factor * film.t), cube)
    words = fall_words(tosses, cube)
    if factor in (1.0, 1.03):
        assert words is None
        return
    assert _number(words, r"fall with ([\d.]+) m/s²") == pytest.approx(9.81 / factor**2, rel=0.02)
    assert _number(words, r"a rate ([\d.]+) times as high") == pytest.approx(factor, rel=0.01)
    assert fall_words(tosses[:1], cube) is not None


def test_a_size_that_is_wrong_is_named(cube: ObjectModel, film: PoseTrack) -> None:
    small = replace(film, q=film.q * [0.8, 0.8, 0.8, 1, 1, 1, 1])
    words = fall_words(segment(small, cube)[0], cube)
    assert _number(words, r"size of the tags \(([\d.]+) times as large") == pytest.approx(1.25, rel=0.02)
    assert fall_words([], cube) is None


@pytest.mark.parametrize("factor", [0.4, 4.0, 10.0])
def test_a_film_in_slow_or_quick_motion_is_told_its_rate(cube: ObjectModel, film: PoseTrack, factor: float) -> None:
    played = replace(film, t=factor * film.t)
    assert not len(segment(played, cube)[0])
    for one in (played, LongTrack("film", played.t, played.frames)):
        words = rate_words(one, cube, segments=SegmentSettings())
        assert _number(words, r"a rate ([\d.]+) times") == pytest.approx(factor, rel=0.01)
        assert ("slow motion" in (words or "")) == (factor > 1)
    resting = replace(film, q=np.tile(film.q[-1], (len(film.t), 1)))
    assert rate_words(resting, cube, segments=SegmentSettings()) is None


# lost frames

TOSSES = 24


def drawn(model: ObjectModel, seed: int, *, planar: bool = False):
    rng = np.random.default_rng(seed)
    return [bounced(model, rng, name=str(i), noise=1e-4, planar=planar) for i in range(TOSSES)]


@pytest.mark.parametrize(("seed", "planar"), [(0, False), (1, False), (2, True), (3, True)])
def test_lost_frames_are_found_and_mended_to_the_true_times(cube: ObjectModel, seed: int, planar: bool) -> None:
    """The frame before the impact, one of the two after it, or two of these; of some tosses none."""
    rng, tracks, times, lost = np.random.default_rng(100 + seed), [], {}, {}
    for i, toss in enumerate(drawn(cube, seed, planar=planar)):
        count = (1, 1, 0, 2)[i % 4]
        at = toss.last + int(rng.integers(0, 2))
        track, times[str(i)] = without(toss.track, list(range(at, at + count)))
        lost[str(i)] = count
        tracks.append(replace(track, v=np.zeros((len(track.t), 6))))
    found = find_lost_frames(tracks, cube)
    judged = {i.toss: i for i in found.impacts if i.lost is not None}
    assert {name: i.lost for name, i in judged.items()} == {name: lost[name] for name in judged}
    assert len(judged) > (0.6 if planar else 0.9) * TOSSES
    assert found.first.is_lossy
    assert found.unjudged == set(times) - set(judged)
    for track in found.mended(tracks):
        assert track.v is None
        if track.name in judged:
            np.testing.assert_allclose(track.t, times[track.name], atol=1e-9)
            skip = judged[track.name].skip / judged[track.name].frame_time
            assert skip == pytest.approx(lost[track.name], abs=0.3)


@pytest.mark.parametrize("seed", range(3))
def test_whole_recordings_and_gaps_that_times_show_lost_nothing(cube: ObjectModel, seed: int) -> None:
    tosses = drawn(cube, seed)
    whole = [toss.track for toss in tosses]
    shown = [replace(track, t=true) for track, true in (without(toss.track, [toss.last + 1]) for toss in tosses)]
    for tracks in (whole, shown):
        found = find_lost_frames(tracks, cube)
        assert found.first.counts[0] > 0.9 * TOSSES
        assert found.first.counts[1:] == (0, 0, 0)
        assert lost_words(found) is None
        assert found.mended(tracks) is tracks
        assert not found.unjudged


def test_bodies_that_tumble_are_judged_too(cube: ObjectModel) -> None:
    """With a constant spin in place of Euler's equations, flights of a twentieth of a second do not meet."""
    slab = cube.with_changes(inertia=cube.inertia * np.diag([1.0, 1.4, 0.6]))
    tracks = [without(toss.track, [toss.last + 1])[0] for toss in drawn(slab, 3)]
    assert find_lost_frames(tracks, slab).first.counts[1] > 0.8 * TOSSES
    assert find_lost_frames(tracks, cube).first.counts[1] < 0.5 * TOSSES


def test_frames_too_many_are_the_measure_of_chance(cube: ObjectModel) -> None:
    """Half of the tosses lost a frame, half have one too many: that is no sign of loss."""
    tracks = []
    for i, toss in enumerate(drawn(cube, 2)):
        t, q, at = toss.track.t, toss.track.q, toss.last + 1
        longer = PoseTrack(str(i), np.append(t, t[-1] + t[1]), np.insert(q, at, q[at], axis=0))
        tracks.append(without(toss.track, [at])[0] if i % 2 else longer)
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
    assert (found.first.impacts, found.later.impacts) == (TOSSES, 0)
    assert found.first.counts[1] > 0.9 * TOSSES


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
        (LcpEngine(), {"restitution": {"e": 0.3}}),
        (LcpEngine(), {"compliance": {"stiffness_npm": 2e4, "damping_nspm": 15.0}}),
        (MujocoEngine(), {}),
        (MujocoEngine(soft=True), {}),
    ],
)
@pytest.mark.filterwarnings("ignore:the contact problem missed")
def test_impacts_that_take_time_or_come_in_pairs_are_no_lost_frames(
    cube: ObjectModel, engine: LcpEngine | MujocoEngine, effects: dict[str, dict[str, float]]
) -> None:
    release, noise = (
        ReleaseSettings(height=(0.2, 0.6), spin=(0.0, 15.0)),
        NoiseSettings(position=1.5e-4, rotation=1.5e-3),
    )
    made = tossid.synthesize(
        cube, tosses=TOSSES, engine=engine, effects=effects, release=release, noise=noise, seconds=0.8
    )
    found = find_lost_frames([PoseTrack(toss.name, toss.t, toss.q) for toss in made.tosses], cube)
    assert found.first.impacts >= TOSSES - 2
    for verdict in (found.first, found.later):
        assert sum(verdict.counts[1:]) + verdict.chance <= 1
        assert not verdict.is_lossy
    assert not effects.get("restitution") or found.later.counts[0] + found.first.counts[0] >= 5
