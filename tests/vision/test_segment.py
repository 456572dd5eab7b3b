"""Segmentation: every toss and nothing else, boundaries within three frames of truth."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest

from tests.vision.conftest import Filmed
from tests.vision.tosses import thrown
from tossid.objects import ObjectModel
from tossid.rotations import quat_exp, quat_mul
from tossid.types import PoseTrack
from tossid.vision.detect import detect_frames
from tossid.vision.segment import rest_frame, segment
from tossid.vision.timeline import Timeline, make_timeline
from tossid.vision.track import track

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


def test_the_rendered_recording_is_cut_right(filmed: Filmed, tagged: ObjectModel):
    tracked, _ = track(detect_frames(filmed.recording, tagged), filmed.recording.cameras, tagged)
    found, _ = segment(tracked, tagged)
    _assert_found(found, filmed.timeline)


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


def test_an_unknown_gravity_still_flies(cube: ObjectModel):
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
