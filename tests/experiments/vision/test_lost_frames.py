"""Tosses lose the frame that is said, and what is counted as right is right."""

from __future__ import annotations

import numpy as np
import pytest

import tossid
from experiments.vision.lost_frames import first_contact, lossy, recovered, row, with_loss
from tossid.motion.sessions.lost_frames import find_lost_frames
from tossid.objects import ObjectModel
from tossid.settings.synthesis import LcpEngine, ReleaseSettings
from tossid.store import Dataset


@pytest.fixture(scope="module")
def made(cube: ObjectModel) -> Dataset:
    high, bouncy = ReleaseSettings(height=(0.3, 0.6), spin=(0.0, 15.0)), {"restitution": {"e": 0.6}}
    return tossid.synthesize(cube, tosses=30, engine=LcpEngine(), effects=bouncy, release=high, seconds=0.7)


def test_tosses_lose_one_frame_beside_their_first_impact(made: Dataset) -> None:
    tracks, lost = lossy(made.tosses, made.tosses, np.random.default_rng(0))
    assert 15 <= sum(frame > 0 for frame in lost) <= 29
    for track, toss, frame in zip(tracks, made.tosses, lost, strict=True):
        fall = np.flatnonzero(np.diff(toss.v[:, 2]) > 0.5)[0]  # the velocity turns round after this frame
        assert abs(first_contact(toss) - fall - 0.5) < 1
        assert not frame or abs(frame - fall - 0.5) < 2
        assert len(track.t) == len(toss.t) - (frame > 0)
        np.testing.assert_array_equal(track.q, np.delete(toss.q, frame, axis=0) if frame else toss.q)
        np.testing.assert_allclose(np.diff(track.t), np.diff(toss.t)[0], rtol=1e-9)


def test_the_table_counts_what_was_lost(cube: ObjectModel, made: Dataset) -> None:
    at = [first_contact(toss) for toss in made.tosses]
    tracks = [with_loss(toss, frame) for toss, frame in zip(made.tosses, at, strict=True)]
    found = find_lost_frames(tracks, cube)
    n = found.first.counts[1]
    assert n >= 8  # from which on it is significant
    assert row("a", found)[1] == f"30: {n} lost 1 **lossy**"
    assert recovered(found, tracks, made.tosses, at) == [f"{n} of {n}", f"{n} of {n}"]
    wrong = [0] * len(at)
    assert recovered(found, tracks, tracks, wrong)[0] == f"0 of {n}"
