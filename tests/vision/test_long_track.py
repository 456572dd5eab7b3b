"""A track that is not in memory as a whole: the same tosses and the same ground, in memory that does not grow."""

from __future__ import annotations

import tracemalloc
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.vision.handling import RATE, Handled, Handling
from tossid.errors import MotionError
from tossid.objects import ObjectModel
from tossid.types import LongTrack, PoseTrack
from tossid.vision import ground, segment
from tossid.vision.spool import PoseSpool, pose_spool

BLOCK = 1500


@pytest.fixture
def short_blocks(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(segment, "BLOCK", BLOCK)
    monkeypatch.setattr(ground, "BLOCK", BLOCK)


@pytest.fixture(scope="module")
def handled(cube: ObjectModel) -> Handled:
    return Handling(cube, np.random.default_rng(7)).recording(60.0)


@pytest.fixture
def track(handled: Handled) -> PoseTrack:
    return handled.tracked(np.random.default_rng(8))


def _spooled(spool: PoseSpool, *tracks: PoseTrack) -> LongTrack:
    for track in tracks:
        for first in range(0, len(track.t), 700):
            spool.add(track.frames(slice(first, first + 700)))
    long = spool.track()
    assert long is not None
    return long


@pytest.mark.parametrize("covariance", [True, False])
def test_what_is_spooled_is_read_as_it_was(track: PoseTrack, tmp_path: Path, covariance: bool) -> None:
    track = track if covariance else replace(track, q_cov=None)
    with pose_spool(tmp_path) as spool:
        assert spool.track() is None
        long = _spooled(spool, track)
        assert list(tmp_path.iterdir()) == []  # nothing is left behind, whatever ends the process
        for which in (slice(None), slice(650, 1500), slice(len(track.t) - 5, len(track.t) + 5)):
            a, b = track.frames(which), long.frames(which)
            np.testing.assert_array_equal(a.t, b.t)
            np.testing.assert_array_equal(a.q, b.q)
            assert (a.q_cov is None) == (b.q_cov is None)
            if a.q_cov is not None:
                np.testing.assert_array_equal(a.q_cov, b.q_cov)
        assert long.name == b.name == track.name


def test_a_spool_takes_one_track(track: PoseTrack, tmp_path: Path) -> None:
    with pose_spool(tmp_path) as spool:
        spool.add(track.frames(slice(100)))
        with pytest.raises(MotionError, match="time does not increase"):
            spool.add(track.frames(slice(99, 200)))
        with pytest.raises(MotionError, match="other columns"):
            spool.add(replace(track.frames(slice(100, 200)), q_cov=None))


def test_the_same_from_a_file_as_in_memory(cube: ObjectModel, track: PoseTrack, tmp_path: Path) -> None:
    with pose_spool(tmp_path) as spool:
        long = _spooled(spool, track)
        (found, rejected), (same, others) = segment.segment(track, cube), segment.segment(long, cube)
        assert rejected == others
        assert [toss.name for toss in found] == [toss.name for toss in same]
        for a, b in zip(found, same, strict=True):
            np.testing.assert_array_equal(a.q, b.q)
        a, b = ground.find_ground(track, cube), ground.find_ground(long, cube)
        assert a.height == b.height
        np.testing.assert_array_equal(a.cov, b.cov)


def test_blocks_change_nothing_but_by_a_frame(
    cube: ObjectModel, handled: Handled, track: PoseTrack, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The noise that is told from a block is not quite that of all."""
    assert len(track.t) > 5 * BLOCK
    found, rejected = segment.segment(track, cube)
    whole = ground.find_ground(track, cube)
    monkeypatch.setattr(segment, "BLOCK", BLOCK)
    monkeypatch.setattr(ground, "BLOCK", BLOCK)
    same, others = segment.segment(track, cube)
    assert len(same) == len(found) == len(handled.release)
    assert [s.reason for s in others] == [s.reason for s in rejected]
    ends = [np.array([[x.t[0], x.t[-1]] for x in tosses]) for tosses in (found, same)]
    assert np.abs(ends[0] - ends[1]).max() < 1.5 / RATE
    assert np.abs([(a.first - b.first, a.last - b.last) for a, b in zip(rejected, others, strict=True)]).max() <= 1
    parts = ground.find_ground(track, cube)
    assert (parts.n_rests, parts.n_left_out, parts.n_falling) == (whole.n_rests, whole.n_left_out, whole.n_falling)
    assert parts.height == pytest.approx(whole.height, abs=1e-7)
    np.testing.assert_allclose(parts.up, whole.up, atol=1e-7)


@pytest.mark.usefixtures("short_blocks")
def test_a_long_rest_is_one(cube: ObjectModel, track: PoseTrack) -> None:
    """Longer than several blocks, before and after a toss."""
    found, _ = segment.segment(track, cube)
    own = track.frames(slice(*np.searchsorted(track.t, [found[1].t[0], found[1].t[-1] + 0.5 / RATE])))
    n, lying = len(own.t), own.q[-1:]
    q = np.concatenate([np.repeat(lying, 4 * BLOCK, axis=0), own.q, np.repeat(lying, 6 * BLOCK + 7, axis=0)])
    q[:, :3] += 2e-5 * np.random.default_rng(9).normal(size=(len(q), 3))
    t = np.arange(len(q)) / RATE
    tosses, stretches = segment.segment(PoseTrack("long", t, q), cube)
    assert len(tosses) == 1
    assert tosses[0].t[0] == pytest.approx(t[4 * BLOCK], abs=3.5 / RATE)
    assert tosses[0].t[-1] == pytest.approx(t[4 * BLOCK + n], abs=3.5 / RATE)
    assert [s.reason for s in stretches].count("resting") == 2
    assert stretches[-1].last == len(q) - 1
    assert stretches[-1].last - stretches[-1].first > 6 * BLOCK


@pytest.mark.usefixtures("short_blocks")
def test_memory_does_not_grow_with_the_track(cube: ObjectModel, track: PoseTrack, tmp_path: Path) -> None:
    n, peaks = len(track.t), []
    for turns in (1, 3):
        with pose_spool(tmp_path) as spool:
            again = [replace(track, t=track.t + turn * (track.t[-1] + 0.5)) for turn in range(turns)]
            long = _spooled(spool, *again)
            del again
            tracemalloc.start()
            found = ground.find_ground(long, cube)
            level = LongTrack(long.name, long.t, lambda which: found.levelled(long.frames(which)))  # noqa: B023
            tosses, _ = segment.segment(level, cube)
            assert sum(len(toss.t) for toss in tosses) > 0.05 * turns * n
            peaks.append(tracemalloc.get_traced_memory()[1])
            tracemalloc.stop()
    # of a frame, some bytes: its time, whether it rests or falls, its toss; in memory it takes 0.35 kB and 1.7 at work
    assert peaks[1] - peaks[0] < 100 * 2 * n
