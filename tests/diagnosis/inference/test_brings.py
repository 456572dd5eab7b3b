"""Whole tosses are predicted better by what was found without them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.diagnosis.by_hand import EFFECTS
from tests.diagnosis.inference.conftest import FRICTION
from tests.diagnosis.inference.test_judge import folds_of
from tests.diagnosis.tossed import seen, with_effect
from tossid.diagnosis.inference.brings import drawn, felt_of_each, noise_limit, whole_tosses, worsen
from tossid.diagnosis.inference.hypothesis import Hypothesis
from tossid.diagnosis.inference.judge import Fold
from tossid.diagnosis.inference.sample import Sample
from tossid.diagnosis.likelihood.windows import make_windows
from tossid.objects import ObjectModel
from tossid.types import Toss


@pytest.fixture(scope="module")
def tosses(cube: ObjectModel) -> list[Toss]:
    return seen(with_effect(cube, "friction", [FRICTION]), cube, 9, seed=3, frames=70)


@pytest.fixture(scope="module")
def sample(cube: ObjectModel, tosses: list[Toss]) -> Sample:
    return Sample(make_windows(tosses, cube), 9)


@pytest.fixture(scope="module")
def folds(sample: Sample, stated: Hypothesis) -> list[Fold]:
    return folds_of(sample, stated)


def test_found_friction_brings_whole_tosses_near_the_recorded_ones(
    cube: ObjectModel, stated: Hypothesis, tosses: list[Toss], sample: Sample, folds: list[Fold]
) -> None:
    found = whole_tosses(folds, tosses, stated)
    (was, now), (was_mm, now_mm) = found.position_pct(), found.position_mm()
    assert now.value < 0.5 * was.value
    assert now.low <= now.value <= now.high
    assert found.worst is not None
    assert [toss.name for toss in tosses].index(found.worst.name) == found.before[:, 0].argmax()
    off = np.linalg.norm(found.worst.before[:, :3] - found.worst.measured[:, :3], axis=1).mean() / cube.width
    assert 100 * off == pytest.approx(found.before[:, 0].max())
    assert was_mm.value == pytest.approx(was.value * 0.01 * 1e3 * cube.width)
    assert now_mm.value < was_mm.value
    # what noise makes is less than what friction made, and what is left is no more
    limit = noise_limit(folds[0].found, tosses, sample, folds=3, seed=0)
    assert not found.is_felt(limit)
    assert limit.position_pct < 0.5 * was.value


def test_an_effect_that_worsens_whole_tosses_is_seen(stated: Hypothesis, tosses: list[Toss], folds: list[Fold]) -> None:
    assert worsen(folds, tosses, ["friction", "gravity"]) == set()
    wrong = stated.plus(EFFECTS["friction"], np.array([FRICTION])).plus(EFFECTS["gravity"], np.array([9.0]))
    instead = [replace(f, found=replace(f.found, fit=_at(f, wrong))) for f in folds]
    assert worsen(instead, tosses, ["friction", "gravity"]) == {"gravity"}


def _at(fold: Fold, hypothesis: Hypothesis):
    evidence = replace(fold.found.fit.evidence, hypothesis=hypothesis)
    return replace(fold.found.fit, evidence=evidence)


def test_whole_tosses_feel_each_effect_as_much_as_it_moves_them(
    stated: Hypothesis, tosses: list[Toss], sample: Sample
) -> None:
    assert felt_of_each(stated, tosses, sample) == {}
    both = stated.plus(EFFECTS["friction"], np.array([FRICTION])).plus(EFFECTS["gravity"], np.array([9.8101]))
    felt = felt_of_each(both, tosses, sample)
    assert felt["friction"].is_over()
    assert not felt["gravity"].is_over()


def test_drawn_parameters_scatter_as_their_intervals_say(folds: list[Fold]) -> None:
    found = folds[0].found
    rng = np.random.default_rng(0)
    values = [drawn(found, rng).values_of("friction")[0] for _ in range(300)]
    interval = found.fit.intervals("friction")["mu"]
    inside = np.mean([(interval.low <= x <= interval.high) for x in values])
    assert 0.93 < inside <= 1.0
