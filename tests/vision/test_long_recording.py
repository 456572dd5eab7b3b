"""Ten minutes in one go: every toss found, nothing else called one, a reason for all else, in linear time."""

from __future__ import annotations

import time
from collections.abc import Sequence

import numpy as np
import pytest

from tests.vision.handling import KINDS, RATE, Handled, Handling
from tossid.objects import ObjectModel
from tossid.types import PoseTrack
from tossid.vision.segment import Stretch, segment

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


def _check(made: Handled, found: Sequence[PoseTrack], rejected: tuple[Stretch, ...]) -> None:
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
        _check(made, found, rejected)


def test_two_minutes_of_an_articulated_object(elbow: ObjectModel) -> None:
    made, found, rejected, _ = _segmented(elbow, 0, 120.0, MEASURED)
    _check(made, found, rejected)


@pytest.mark.parametrize("seed", [1011, 1027])
def test_what_stands_for_a_moment_and_tips_over_has_not_come_to_rest(elbow: ObjectModel, seed: int) -> None:
    """In one toss of each a link stands upright for a quarter of a second, on what does not hold."""
    rng = np.random.default_rng(seed)
    made = Handling(elbow, rng, kinds={"toss": 1}).recording(40.0)
    found, rejected = segment(made.tracked(rng), elbow)
    _check(made, found, rejected)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [11, 12, 13])
def test_ten_minutes_of_a_cube(cube: ObjectModel, seed: int) -> None:
    made, found, rejected, _ = _segmented(cube, seed, 600.0, MEASURED)
    assert {kind for _, _, kind in made.kinds} == set(KINDS)
    assert len(found) > 80
    _check(made, found, rejected)


@pytest.mark.slow
def test_ten_minutes_of_an_articulated_object(elbow: ObjectModel) -> None:
    made, found, rejected, _ = _segmented(elbow, 12, 600.0, MEASURED)
    _check(made, found, rejected)


@pytest.mark.slow
def test_time_grows_with_the_recording_and_no_faster(cube: ObjectModel) -> None:
    short = min(_segmented(cube, seed, 120.0, MEASURED)[3] for seed in (20, 21, 22))
    long = min(_segmented(cube, seed, 600.0, MEASURED)[3] for seed in (20, 21))
    assert long < 2.0 * 5.0 * short
