"""The gap: 1 at the truth, above it elsewhere, with shares that add up and intervals over tosses."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.diagnosis.tossed import seen
from tossid.diagnosis.findings import Interval
from tossid.diagnosis.likelihood.evidence import Hypothesis
from tossid.diagnosis.localisation.gap import (
    bootstrap_ratio,
    by_toss,
    channels_of,
    deviance,
    measure_gap,
    share_left,
)
from tossid.diagnosis.localisation.noise import noise_floor
from tossid.diagnosis.selection.cross_validation import CrossValidator
from tossid.objects import ObjectModel
from tossid.physics.effects import LIBRARY, World
from tossid.settings.changed import changed
from tossid.settings.diagnosis.diagnose import DiagnoseSettings
from tossid.types import Toss

FRICTION = next(effect for effect in LIBRARY if effect.name == "friction")
COUNT = 8


@pytest.fixture(scope="module")
def tosses(cube: ObjectModel) -> list[Toss]:
    """Of a cube with friction 0.3, where 0.18 is stated."""
    return seen(World(cube.with_changes(friction=0.3)), cube, COUNT, seed=4)


@pytest.fixture(scope="module")
def validator(cube: ObjectModel, tosses: list[Toss]) -> CrossValidator:
    return CrossValidator.of(tosses, cube, seed=0, settings=changed(DiagnoseSettings(), {"other_lengths": (10,)}))


def test_what_an_impact_gets_wrong_is_seen_after_it(cube: ObjectModel) -> None:
    """A missing bounce leaves nothing in flight before and little at the impact itself: most is in what follows it."""
    made = seen(World(cube.with_changes(restitution=0.5)), cube, COUNT, seed=4)
    validator = CrossValidator.of(made, cube, seed=0, settings=changed(DiagnoseSettings(), {"other_lengths": (10,)}))
    gap = measure_gap(made, validator.evaluate(Hypothesis(World(cube))), validator, noise_floor(validator.windows))
    assert gap.after_impacts.share.value > 0.6


def test_friction_closes_the_gap_that_it_makes(
    cube: ObjectModel, tosses: list[Toss], validator: CrossValidator
) -> None:
    stated = Hypothesis(World(cube))
    first, last = validator.evaluate(stated), validator.evaluate(stated.plus(FRICTION, np.array([0.3])))
    floor = noise_floor(validator.windows)
    assert floor.rms == pytest.approx(1.0, abs=0.1)
    gap, left = (measure_gap(tosses, each, validator, floor) for each in (first, last))
    assert gap.total.value > 2 * left.total.value
    assert sum(share.share.value for share in gap.by_phase) == pytest.approx(1.0)
    assert sum(share.share.value for share in gap.by_channel) == pytest.approx(1.0)
    assert next(share.share.value for share in gap.by_phase if share.name == "slide") > 0.4
    assert [frames for frames, _, _ in gap.by_length] == [10, 20]
    assert 0.1 < gap.after_impacts.share.value < 0.9
    closed, unexplained = share_left(first, last, validator, floor)
    assert closed.value > 0.8
    assert unexplained == ()
    nothing, everything = share_left(first, first, validator, floor)
    assert nothing.value == pytest.approx(0.0, abs=1e-12)
    assert "slide" in [share.name for share in everything]


def test_a_gap_below_the_floor_is_closed_by_what_leaves_less(cube: ObjectModel, validator: CrossValidator) -> None:
    stated = Hypothesis(World(cube))
    first, last = validator.evaluate(stated), validator.evaluate(stated.plus(FRICTION, np.array([0.3])))
    floor = noise_floor(validator.windows)
    high = replace(floor, deviance=20.0 * floor.deviance)
    closed, unexplained = share_left(first, last, validator, high)
    assert closed.value == pytest.approx(1.0)
    assert unexplained == ()
    for one, other in ((first, first), (last, first)):  # nothing is better than what was there
        assert share_left(one, other, validator, high) == (Interval(0.0, 0.0, 0.0), ())


def test_sums_by_toss_are_those_of_its_windows(cube: ObjectModel, validator: CrossValidator) -> None:
    evidence = validator.evaluate(Hypothesis(World(cube))).evidence
    values = deviance(evidence, np.ones(evidence.windows.noise.shape))
    sums = by_toss(evidence, values, COUNT)
    assert sums.sum() == pytest.approx(values.sum())
    counts = np.bincount(evidence.windows.toss, weights=evidence.windows.counted.sum(1))
    np.testing.assert_allclose(sums / counts, sums[0] / counts[0])


def test_the_interval_of_a_ratio_covers_it() -> None:
    """95 % intervals of a ratio of sums over 40 tosses, in 200 draws."""
    inside = 0
    for seed in range(200):
        rng = np.random.default_rng(seed)
        below = rng.uniform(1, 3, 40)
        ratio = bootstrap_ratio(0.4 * below + rng.normal(0, 0.3, 40), below, seed=seed)
        inside += ratio.low <= 0.4 <= ratio.high
    assert 180 <= inside <= 198


def test_joints_are_channels() -> None:
    assert channels_of(7)[-1] == "joint_1"
