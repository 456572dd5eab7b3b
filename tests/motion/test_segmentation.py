"""Segmentation: every toss and nothing else, boundaries within three frames of truth."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from tests.motion.bouncing import track_of
from tests.motion.handling import Handled, Handling
from tests.vision.tosses import thrown
from tossid.motion import segmentation
from tossid.motion.segmentation import Stretch, rest_frame, segment
from tossid.motion.sessions.witnesses import fall_words
from tossid.objects import ObjectModel
from tossid.synthesis.timeline import Timeline, make_timeline
from tossid.types import LongTrack, PoseTrack

RATE = 148.0
MEASURED, COARSE, ONE_CAMERA = (5e-5, 5e-4), (1e-4, 2e-3), (2e-3, 1e-2)
"""Noise [m, rad]: some times that of three cameras of 1280 by 1024 px, a poor tracker's, and one camera's."""


def _made(cube: ObjectModel, seed: int, count: int, **keys: float) -> tuple[Timeline, np.random.Generator]:
    rng = np.random.default_rng(seed)
    return make_timeline([thrown(cube, rng) for _ in range(count)], cube, rng, **keys), rng


def _ends(toss: PoseTrack, t0: float) -> tuple[int, int]:
    return round((toss.t[0] - t0) * RATE), round((toss.t[-1] - t0) * RATE)


def _assert_found(
    found: Sequence[PoseTrack], t0: float, release: Sequence[int], rest: Sequence[int], within: tuple[int, int] = (3, 3)
) -> None:
    spans = [_ends(toss, t0) for toss in found]
    assert len(spans) == len(release)  # none missing, none that is no toss
    for (first, last), begin, end in zip(spans, release, rest, strict=True):
        assert abs(first - begin) <= within[0]
        assert abs(last - end) <= within[1]


def _assert_covered(found: Sequence[PoseTrack], rejected: Sequence[Stretch], t: np.ndarray, seen: np.ndarray) -> None:
    """Every frame is in one toss or one stretch, but for the first of a rest, which belongs to neither side."""
    covered = np.zeros(len(t), dtype=int)
    for first, last in [_ends(toss, t[0]) for toss in found]:
        covered[first : last + 1] += 1
    for stretch in rejected:
        assert stretch.reason
        covered[round((stretch.t0 - t[0]) * RATE) : round((stretch.t1 - t[0]) * RATE) + 1] += 1
    assert covered.max() == 1
    assert (covered[seen] == 0).mean() < 0.005


def test_a_long_gap_in_a_toss_rejects_it_and_short_ones_are_bridged(cube: ObjectModel) -> None:
    timeline, rng = _made(cube, 13, 3)
    whole = track_of(timeline.t, timeline.q, rng, COARSE)

    def without(*frames: int) -> PoseTrack:
        keep = np.delete(np.arange(len(whole.t)), frames)
        return PoseTrack("x", whole.t[keep], whole.q[keep], whole.q_cov[keep])

    found, _ = segment(without(*timeline.release + 40, *timeline.release + 41), cube)
    _assert_found(found, timeline.t[0], timeline.release, timeline.rest)
    middle = int(timeline.release[1]) + 30
    found, rejected = segment(without(*range(middle, middle + 12)), cube)
    starts = np.array([_ends(toss, timeline.t[0])[0] for toss in found])
    assert [bool(np.abs(starts - release).min() <= 3) for release in timeline.release] == [True, False, True]
    assert any("lost from view" in stretch.reason for stretch in rejected)


def test_flights_are_found_without_knowing_gravity(cube: ObjectModel) -> None:
    """A toss in a field a little off 9.81 (a real effect to be found later) is still one."""
    timeline, rng = _made(cube, 15, 2)
    found, _ = segment(track_of(timeline.t, timeline.q, rng, COARSE), cube, gravity=8.6)
    _assert_found(found, timeline.t[0], timeline.release, timeline.rest)


def test_rest_begins_where_motion_ends() -> None:
    q = np.zeros((100, 7))
    q[:, 3], q[:40, 0] = 1.0, 0.002 * np.arange(40, 0, -1)  # 2 mm a frame, then still
    assert rest_frame(q) == 40
    q[70, 0] = 0.01  # one bad frame is no motion
    assert rest_frame(q) == 40


@pytest.mark.parametrize(
    ("which", "seed", "seconds", "noise", "within"),
    [
        ("cube", 0, 120.0, MEASURED, (3, 3)),
        ("cube", 1, 120.0, COARSE, (3, 3)),
        ("cube", 2, 60.0, ONE_CAMERA, (12, 26)),  # what moves by less than the noise is at rest
        ("elbow", 0, 120.0, MEASURED, (3, 3)),
    ],
)
def test_minutes_of_tosses_and_of_what_hands_do_between_them(
    which: str,
    seed: int,
    seconds: float,
    noise: tuple[float, float],
    within: tuple[int, int],
    request: pytest.FixtureRequest,
) -> None:
    model, rng = request.getfixturevalue(which), np.random.default_rng(seed)
    made = Handling(model, rng).recording(seconds)
    found, rejected = segment(made.tracked(rng, sigma=noise[0], turn=noise[1]), model)
    _assert_found(found, made.t[0], made.release, made.rest, within)
    _assert_covered(found, rejected, made.t, made.seen)
    reasons = {stretch.reason for stretch in rejected}
    assert reasons >= {"resting", "carried", "carried: no free flight", "taken up again before it rested"}


@pytest.mark.parametrize(("step", "noise"), [(2, ONE_CAMERA), (3, COARSE), (3, ONE_CAMERA), (5, (5e-4, 4e-3))])
def test_tosses_are_found_at_the_rates_of_phones(cube: ObjectModel, step: int, noise: tuple[float, float]) -> None:
    """74, 49 and 30 frames a second: nothing is taken for a toss, and hardly one is missed."""
    missed = 0
    for seed in (0, 1):
        rng = np.random.default_rng(seed)
        made = Handling(cube, rng).recording(40.0)
        whole = made.tracked(rng, sigma=noise[0], turn=noise[1])
        track = PoseTrack("phone", whole.t[::step], whole.q[::step], whole.q_cov[::step])
        starts = np.array([_ends(toss, made.t[0])[0] for toss in segment(track, cube)[0]])
        off = np.abs(starts[:, None] - np.array(made.release))
        assert (off.min(axis=1) < 20).all()
        missed += int((off.min(axis=0) >= 20).sum())
    assert missed <= 1


def test_what_stands_for_a_moment_and_tips_over_has_not_come_to_rest(elbow: ObjectModel) -> None:
    """In one of the tosses a link stands upright for a quarter of a second, on what does not hold."""
    rng = np.random.default_rng(1011)
    made = Handling(elbow, rng, kinds={"toss": 1}).recording(40.0)
    found, _ = segment(made.tracked(rng), elbow)
    _assert_found(found, made.t[0], made.release, made.rest)


BLOCK = 1500
"""Frames of a block that is far shorter than a recording."""


@pytest.fixture(scope="module")
def handled(cube: ObjectModel) -> Handled:
    return Handling(cube, np.random.default_rng(7)).recording(60.0)


def test_short_blocks_read_on_demand_change_ends_by_a_frame_at_most(
    cube: ObjectModel, handled: Handled, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The noise that a block shows is not quite that of the whole track."""
    track = handled.tracked(np.random.default_rng(8))
    assert len(track.t) > 5 * BLOCK
    found, rejected = segment(track, cube)
    on_demand, same_rejected = segment(LongTrack(track.name, track.t, track.frames), cube)
    assert rejected == same_rejected
    for a, b in zip(found, on_demand, strict=True):
        np.testing.assert_array_equal(a.q, b.q)
    monkeypatch.setattr(segmentation, "BLOCK_FRAMES", BLOCK)
    same, others = segment(track, cube)
    assert len(same) == len(found) == len(handled.release)
    assert [s.reason for s in others] == [s.reason for s in rejected]
    ends = [np.array([[x.t[0], x.t[-1]] for x in tosses]) for tosses in (found, same)]
    assert np.abs(ends[0] - ends[1]).max() < 1.5 / RATE
    assert np.abs([(a.first - b.first, a.last - b.last) for a, b in zip(rejected, others, strict=True)]).max() <= 1
    # a rest of several blocks, before and after a toss, is one
    own = track.frames(slice(*np.searchsorted(track.t, [found[1].t[0], found[1].t[-1] + 0.5 / RATE])))
    n, lying = len(own.t), own.q[-1:]
    q = np.concatenate([np.repeat(lying, 4 * BLOCK, axis=0), own.q, np.repeat(lying, 6 * BLOCK + 7, axis=0)])
    q[:, :3] += 2e-5 * np.random.default_rng(9).normal(size=(len(q), 3))
    (toss,), stretches = segment(PoseTrack("long", np.arange(len(q)) / RATE, q), cube)
    assert _ends(toss, 0.0) == (pytest.approx(4 * BLOCK, abs=3), pytest.approx(4 * BLOCK + n, abs=3))
    assert [s.reason for s in stretches].count("resting") == 2
    assert stretches[-1].last == len(q) - 1
    assert stretches[-1].last - stretches[-1].first > 6 * BLOCK


@pytest.mark.parametrize(("what", "factor"), [*(("times", by) for by in (0.85, 1.03, 1.3)), ("lengths", 1.118)])
def test_times_or_lengths_that_are_wrong_are_named_by_their_factor(cube: ObjectModel, what: str, factor: float) -> None:
    rng = np.random.default_rng(0)
    film = Handling(cube, rng).recording(15.0).tracked(rng)
    length = 1.0 if what == "times" else factor**-2
    film = replace(film, t=film.t * (factor if what == "times" else 1.0), q=film.q * ([length] * 3 + [1.0] * 4))
    words = fall_words(segment(film, cube)[0], cube)
    if factor == 1.03:
        assert words is None
        return
    found = re.search(r"with ([\d.]+) m.*rate ([\d.]+) times.*tags \(([\d.]+) times", words)
    size, rate, scale = map(float, found.groups())
    assert size == pytest.approx(9.81 / factor**2, rel=0.02)
    assert rate == pytest.approx(factor, rel=0.01)
    assert scale == pytest.approx(factor**2, rel=0.02)
