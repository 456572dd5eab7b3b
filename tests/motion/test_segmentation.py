"""Segmentation: every toss and nothing else, boundaries within three frames of truth."""

from __future__ import annotations

import time
from collections.abc import Sequence

import numpy as np
import pytest

from tests.motion.handling import KINDS, Handled, Handling
from tests.vision.tosses import thrown
from tossid.motion.segmentation import Stretch, rest_frame, segment
from tossid.objects import ObjectModel
from tossid.rotations import quat_exp, quat_mul
from tossid.settings.segmentation import SegmentSettings
from tossid.synthesis.timeline import Timeline, make_timeline
from tossid.types import LongTrack, PoseTrack

RATE = 148.0


def _tracked(timeline: Timeline, rng: np.random.Generator, *, sigma: float = 1e-4, turn: float = 2e-3) -> PoseTrack:
    n = len(timeline.t)
    q = timeline.q.copy()
    q[:, :3] += sigma * rng.normal(size=(n, 3))
    q[:, 3:7] = quat_mul(q[:, 3:7], quat_exp(turn * rng.normal(size=(n, 3))))
    cov = np.tile(np.diag([sigma**2] * 3 + [turn**2] * 3), (n, 1, 1))
    return PoseTrack("recording", timeline.t, q, cov)


def _frames(track_: PoseTrack, timeline: Timeline) -> tuple[int, int]:
    ends = (track_.t[[0, -1]] - timeline.t[0]) * RATE
    return round(ends[0]), round(ends[1])


def _assert_found(found: Sequence[PoseTrack], timeline: Timeline) -> None:
    assert len(found) == len(timeline.release)
    for toss, release, rest in zip(found, timeline.release, timeline.rest, strict=True):
        first, last = _frames(toss, timeline)
        assert abs(first - release) <= 3
        assert abs(last - rest) <= 3


@pytest.mark.parametrize(("sigma", "turn"), [(3e-5, 5e-4), (1e-4, 2e-3), (2e-4, 3e-3)])
def test_every_toss_is_found(cube: ObjectModel, sigma: float, turn: float):
    for seed in range(3):
        rng = np.random.default_rng(seed)
        timeline = make_timeline([thrown(cube, rng) for _ in range(6)], cube, rng, start=5.0)
        found, rejected = segment(_tracked(timeline, rng, sigma=sigma, turn=turn), cube)
        _assert_found(found, timeline)
        assert {stretch.reason for stretch in rejected} == {"resting", "carried"}


def test_every_frame_is_accounted_for(cube: ObjectModel):
    rng = np.random.default_rng(9)
    timeline = make_timeline([thrown(cube, rng) for _ in range(3)], cube, rng)
    found, rejected = segment(_tracked(timeline, rng), cube)
    spans = [_frames(toss, timeline) for toss in found] + [(s.first, s.last) for s in rejected]
    covered = np.zeros(len(timeline.t), dtype=int)
    for first, last in spans:
        covered[first : last + 1] += 1
    assert covered.max() == 1  # nothing twice
    assert (covered == 0).sum() <= 2  # the first frame of the first rest belongs to no stretch


def test_carrying_without_a_throw_is_no_toss(cube: ObjectModel):
    """Lifted, carried about and set down: the flight's acceleration is missing."""
    t = np.arange(400) / RATE
    s = np.clip((t - 0.3) / 2.0, 0, 1)
    ease = s**3 * (10 - 15 * s + 6 * s**2)
    q = np.zeros((400, 7))
    q[:, 0], q[:, 2], q[:, 3] = 0.5 * ease, 0.0524 + 0.25 * np.sin(np.pi * ease) ** 2, 1.0
    rng = np.random.default_rng(0)
    found, rejected = segment(_tracked(Timeline(t, q, (), np.zeros(0), np.zeros(0)), rng), cube)
    assert len(found) == 0
    assert {stretch.reason for stretch in rejected} == {"resting", "carried: no free flight"}


def test_a_throw_that_is_caught_is_no_toss(cube: ObjectModel):
    """Thrown up and caught in the air: a free flight that does not end on the ground."""
    t = np.arange(320) / RATE
    z = np.full(320, 0.0524)
    up, catch = slice(80, 110), slice(150, 190)
    flight = np.arange(110, 150)
    v0, z0 = 1.6, 0.35
    s = np.linspace(0, 1, 30)
    # a push that ends with the throw's height and speed
    d, v = z0 - 0.0524, v0 * 30 / RATE
    z[up] = 0.0524 + d * s**3 * (10 - 15 * s + 6 * s**2) + v * s**3 * (-4 + 7 * s - 3 * s**2)
    tau = (flight - 110) / RATE
    z[flight] = z0 + v0 * tau - 0.5 * 9.81 * tau**2
    end = z[flight[-1]]
    s = np.linspace(0, 1, 40)
    speed = (v0 - 9.81 * tau[-1]) * 40 / RATE
    z[catch] = end + speed * s * (1 - s) ** 3 + (0.0524 - end) * s**3 * (10 - 15 * s + 6 * s**2)
    q = np.zeros((320, 7))
    q[:, 2], q[:, 3] = z, 1.0
    rng = np.random.default_rng(0)
    found, rejected = segment(_tracked(Timeline(t, q, (), np.zeros(0), np.zeros(0)), rng), cube)
    assert len(found) == 0
    assert any(stretch.reason.startswith("carried") for stretch in rejected)


def test_a_toss_taken_up_before_it_rests_is_no_toss(cube: ObjectModel):
    rng = np.random.default_rng(12)
    timeline = make_timeline([thrown(cube, rng) for _ in range(2)], cube, rng)
    # cut the first toss's end and the rest after it out: a hand takes the object up while it still moves
    cut_from, cut_to = int(timeline.rest[0]) - 25, int(timeline.release[1]) - 45
    keep = np.r_[0:cut_from, cut_to : len(timeline.t)]
    q = timeline.q[keep].copy()
    # close the gap with a quick smooth move
    step = q[cut_from, :3] - q[cut_from - 1, :3]
    q[:cut_from, :2] += step[:2]
    q[cut_from:, 2] -= step[2] * np.exp(-np.arange(len(q) - cut_from) / 4.0)
    shortened = Timeline(timeline.t[: len(keep)], q, (), np.zeros(0), np.zeros(0))
    found, rejected = segment(_tracked(shortened, rng), cube)
    release = int(timeline.release[1]) - (cut_to - cut_from)
    assert len(found) == 1
    assert abs(_frames(found[0], shortened)[0] - release) <= 3
    assert any("taken up again" in stretch.reason for stretch in rejected)


def test_a_gap_in_a_toss_rejects_it(cube: ObjectModel):
    rng = np.random.default_rng(13)
    timeline = make_timeline([thrown(cube, rng) for _ in range(3)], cube, rng)
    whole = _tracked(timeline, rng)
    middle = int(timeline.release[1]) + 30
    keep = np.r_[0:middle, middle + 12 : len(timeline.t)]
    assert whole.q_cov is not None
    found, rejected = segment(PoseTrack("x", whole.t[keep], whole.q[keep], whole.q_cov[keep]), cube)
    starts = [_frames(toss, timeline)[0] for toss in found]
    assert any(abs(start - timeline.release[0]) <= 3 for start in starts)
    assert any(abs(start - timeline.release[2]) <= 3 for start in starts)
    assert not any(abs(start - timeline.release[1]) <= 3 for start in starts)
    assert any("lost from view" in stretch.reason for stretch in rejected)


def test_short_gaps_are_bridged(cube: ObjectModel):
    rng = np.random.default_rng(14)
    timeline = make_timeline([thrown(cube, rng) for _ in range(2)], cube, rng)
    whole = _tracked(timeline, rng)
    keep = np.ones(len(whole.t), dtype=bool)
    keep[timeline.release + 40] = False
    keep[timeline.release + 41] = False
    assert whole.q_cov is not None
    found, _ = segment(PoseTrack("x", whole.t[keep], whole.q[keep], whole.q_cov[keep]), cube)
    _assert_found(found, timeline)


def test_flights_are_found_without_knowing_gravity(cube: ObjectModel):
    """A toss in a field a little off 9.81 (a real effect to be found later) is still one."""
    rng = np.random.default_rng(15)
    timeline = make_timeline([thrown(cube, rng) for _ in range(2)], cube, rng)
    found, _ = segment(_tracked(timeline, rng), cube, gravity=8.6)
    _assert_found(found, timeline)


def test_rest_begins_where_motion_ends():
    n = 100
    q = np.zeros((n, 7))
    q[:, 3] = 1.0
    q[:40, 0] = 0.002 * np.arange(40, 0, -1)  # 2 mm a frame, then still
    assert rest_frame(q) == 40
    q[70, 0] = 0.01  # one bad frame is no motion
    assert rest_frame(q) == 40


MEASURED, COARSE = (5e-5, 5e-4), (1e-4, 2e-3)
"""Noise [m, rad]: some times that of three cameras of 1280 by 1024 px, and a poor tracker's."""


def _segmented(
    model: ObjectModel, seed: int, seconds: float, noise: tuple[float, float]
) -> tuple[Handled, Sequence[PoseTrack], tuple[Stretch, ...], float]:
    rng = np.random.default_rng(seed)
    made = Handling(model, rng).recording(seconds)
    track = made.tracked(rng, sigma=noise[0], turn=noise[1])
    started = time.perf_counter()
    found, rejected = segment(track, model)
    return made, found, rejected, time.perf_counter() - started


def _check_handled(made: Handled, found: Sequence[PoseTrack], rejected: tuple[Stretch, ...]) -> None:
    spans = [(round((toss.t[0] - made.t[0]) * RATE), round((toss.t[-1] - made.t[0]) * RATE)) for toss in found]
    assert len(spans) == len(made.release)  # none missing, none that is no toss
    for (first, last), release, rest in zip(spans, made.release, made.rest, strict=True):
        assert abs(first - release) <= 3
        assert abs(last - rest) <= 3
    covered = np.zeros(len(made.q), dtype=int)
    for first, last in spans:
        covered[first : last + 1] += 1
    for stretch in rejected:
        assert stretch.reason
        covered[round((stretch.t0 - made.t[0]) * RATE) : round((stretch.t1 - made.t[0]) * RATE) + 1] += 1
    assert covered.max() == 1
    assert (covered[made.seen] == 0).mean() < 0.005  # the first frame of a rest belongs to neither side


@pytest.mark.parametrize("noise", [MEASURED, COARSE])
def test_two_minutes_of_a_cube(cube: ObjectModel, noise: tuple[float, float]) -> None:
    for seed in (0, 1):
        made, found, rejected, _ = _segmented(cube, seed, 120.0, noise)
        _check_handled(made, found, rejected)


def test_two_minutes_of_an_articulated_object(elbow: ObjectModel) -> None:
    made, found, rejected, _ = _segmented(elbow, 0, 120.0, MEASURED)
    _check_handled(made, found, rejected)


@pytest.mark.parametrize("seed", [1011, 1027])
def test_what_stands_for_a_moment_and_tips_over_has_not_come_to_rest(elbow: ObjectModel, seed: int) -> None:
    """In one toss of each a link stands upright for a quarter of a second, on what does not hold."""
    rng = np.random.default_rng(seed)
    made = Handling(elbow, rng, kinds={"toss": 1}).recording(40.0)
    found, rejected = segment(made.tracked(rng), elbow)
    _check_handled(made, found, rejected)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [11, 12, 13])
def test_ten_minutes_of_a_cube(cube: ObjectModel, seed: int) -> None:
    made, found, rejected, _ = _segmented(cube, seed, 600.0, MEASURED)
    assert {kind for _, _, kind in made.kinds} == set(KINDS)
    assert len(found) > 80
    _check_handled(made, found, rejected)


@pytest.mark.slow
def test_ten_minutes_of_an_articulated_object(elbow: ObjectModel) -> None:
    made, found, rejected, _ = _segmented(elbow, 12, 600.0, MEASURED)
    _check_handled(made, found, rejected)


@pytest.mark.slow
def test_time_grows_with_the_recording_and_no_faster(cube: ObjectModel) -> None:
    short = min(_segmented(cube, seed, 120.0, MEASURED)[3] for seed in (20, 21, 22))
    long = min(_segmented(cube, seed, 600.0, MEASURED)[3] for seed in (20, 21))
    assert long < 2.0 * 5.0 * short


BLOCK = 1500
SHORT = SegmentSettings(block_frames=BLOCK)
"""Of blocks that are far shorter than a recording."""


@pytest.fixture(scope="module")
def handled(cube: ObjectModel) -> Handled:
    return Handling(cube, np.random.default_rng(7)).recording(60.0)


@pytest.fixture
def long_track(handled: Handled) -> PoseTrack:
    return handled.tracked(np.random.default_rng(8))


def test_a_track_that_is_read_on_demand_gives_the_same(cube: ObjectModel, long_track: PoseTrack) -> None:
    on_demand = LongTrack(long_track.name, long_track.t, long_track.frames)
    (found, rejected), (same, others) = segment(long_track, cube), segment(on_demand, cube)
    assert rejected == others
    assert [toss.name for toss in found] == [toss.name for toss in same]
    for a, b in zip(found, same, strict=True):
        np.testing.assert_array_equal(a.q, b.q)


def test_short_blocks_change_ends_by_a_frame_at_most(
    cube: ObjectModel, handled: Handled, long_track: PoseTrack
) -> None:
    """The noise that a block shows is not quite that of the whole track."""
    assert len(long_track.t) > 5 * BLOCK
    found, rejected = segment(long_track, cube)
    same, others = segment(long_track, cube, settings=SHORT)
    assert len(same) == len(found) == len(handled.release)
    assert [s.reason for s in others] == [s.reason for s in rejected]
    ends = [np.array([[x.t[0], x.t[-1]] for x in tosses]) for tosses in (found, same)]
    assert np.abs(ends[0] - ends[1]).max() < 1.5 / RATE
    assert np.abs([(a.first - b.first, a.last - b.last) for a, b in zip(rejected, others, strict=True)]).max() <= 1


def test_a_rest_of_several_blocks_is_one(cube: ObjectModel, long_track: PoseTrack) -> None:
    """Before and after a toss."""
    found, _ = segment(long_track, cube, settings=SHORT)
    own = long_track.frames(slice(*np.searchsorted(long_track.t, [found[1].t[0], found[1].t[-1] + 0.5 / RATE])))
    n, lying = len(own.t), own.q[-1:]
    q = np.concatenate([np.repeat(lying, 4 * BLOCK, axis=0), own.q, np.repeat(lying, 6 * BLOCK + 7, axis=0)])
    q[:, :3] += 2e-5 * np.random.default_rng(9).normal(size=(len(q), 3))
    t = np.arange(len(q)) / RATE
    tosses, stretches = segment(PoseTrack("long", t, q), cube, settings=SHORT)
    assert len(tosses) == 1
    assert tosses[0].t[0] == pytest.approx(t[4 * BLOCK], abs=3.5 / RATE)
    assert tosses[0].t[-1] == pytest.approx(t[4 * BLOCK + n], abs=3.5 / RATE)
    assert [s.reason for s in stretches].count("resting") == 2
    assert stretches[-1].last == len(q) - 1
    assert stretches[-1].last - stretches[-1].first > 6 * BLOCK
