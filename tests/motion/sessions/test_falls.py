"""Tosses that do not fall are told, with the rate or the size that explains it."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest

from tests.motion.handling import Handling
from tossid.motion.segmentation import segment
from tossid.motion.sessions.falls import fall_words, rate_words
from tossid.objects import ObjectModel
from tossid.settings.segmentation import SegmentSettings
from tossid.types import LongTrack, PoseTrack

SEGMENTS = SegmentSettings()


@pytest.fixture(scope="module")
def track(cube: ObjectModel) -> PoseTrack:
    rng = np.random.default_rng(0)
    return Handling(cube, rng).recording(15.0).tracked(rng)


def _sized(track: PoseTrack, factor: float) -> PoseTrack:
    q = track.q.copy()
    q[:, :3] *= factor
    return replace(track, q=q)


def _numbers(words: str, *patterns: str) -> list[float]:
    found = [re.search(pattern, words) for pattern in patterns]
    assert all(found), words
    return [float(match[1]) for match in found if match]


@pytest.mark.parametrize("factor", [0.85, 0.9, 1.0, 1.03, 1.1, 1.17, 1.3])
def test_times_that_are_wrong_a_little_are_named_by_the_rate(cube: ObjectModel, track: PoseTrack, factor: float):
    tosses, _ = segment(replace(track, t=factor * track.t), cube)
    words = fall_words(tosses, cube)
    if factor in (1.0, 1.03):
        assert words is None
        return
    assert words is not None
    gravity, rate = _numbers(words, r"fall with ([\d.]+) m/s²", r"a rate ([\d.]+) times as high")
    assert gravity == pytest.approx(9.81 / factor**2, rel=0.02)
    assert rate == pytest.approx(factor, rel=0.01)


def test_a_size_that_is_wrong_is_named(cube: ObjectModel, track: PoseTrack):
    tosses, _ = segment(_sized(track, 0.8), cube)
    (size,) = _numbers(fall_words(tosses, cube) or "", r"size of the tags \(([\d.]+) times as large")
    assert size == pytest.approx(1.25, rel=0.02)
    assert fall_words(segment(track, cube)[0][:1], cube) is None


def test_one_toss_is_enough_and_none_says_nothing(cube: ObjectModel, track: PoseTrack):
    tosses, _ = segment(replace(track, t=1.2 * track.t), cube)
    assert fall_words(tosses[:1], cube) is not None
    assert fall_words([], cube) is None


@pytest.mark.parametrize("factor", [0.4, 2.0, 4.0, 8.0, 10.0])
def test_a_film_in_slow_or_quick_motion_is_told_its_rate(cube: ObjectModel, track: PoseTrack, factor: float):
    played = replace(track, t=factor * track.t)
    assert not len(segment(played, cube)[0])
    long = LongTrack("film", played.t, lambda which: replace(played, t=played.t[which], q=played.q[which], q_cov=None))
    for one in (played, long):
        words = rate_words(one, cube, segments=SEGMENTS)
        assert words is not None
        assert _numbers(words, r"a rate ([\d.]+) times") == pytest.approx([factor], rel=0.01)
        assert ("slow motion" in words) == (factor > 1)


def test_a_track_without_tosses_is_told_no_rate(cube: ObjectModel, track: PoseTrack):
    resting = replace(track, q=np.tile(track.q[-1], (len(track.t), 1)))
    assert rate_words(resting, cube, segments=SEGMENTS) is None
