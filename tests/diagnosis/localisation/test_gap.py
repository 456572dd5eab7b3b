"""The gap: 1 at the truth, above it elsewhere, with shares that add up and intervals over tosses."""

from __future__ import annotations

import numpy as np
import pytest

from tests.diagnosis.tossed import seen, with_effect
from tossid.diagnosis.inference.evidence import Evidence, collect
from tossid.diagnosis.inference.hypothesis import Hypothesis
from tossid.diagnosis.likelihood.windows import Windows, make_windows
from tossid.diagnosis.localisation.gap import (
    Rows,
    channels_of,
    in_short,
    is_clear,
    measure_gap,
    phases_left,
    rows_of,
    share_closed_in,
)
from tossid.diagnosis.localisation.noise import Floor, noise_floor
from tossid.objects import ObjectModel
from tossid.physics.effects import World
from tossid.types import Phase, Toss

COUNT = 8


@pytest.fixture(scope="module")
def tosses(cube: ObjectModel) -> list[Toss]:
    """Of a cube with friction 0.3, where 0.18 is stated."""
    return seen(with_effect(cube, "friction", [0.3]), cube, COUNT, seed=4)


@pytest.fixture(scope="module")
def windows(cube: ObjectModel, tosses: list[Toss]) -> Windows:
    return make_windows(tosses, cube)


@pytest.fixture(scope="module")
def floor(windows: Windows) -> Floor:
    return noise_floor(windows)


@pytest.fixture(scope="module")
def stated(cube: ObjectModel, windows: Windows) -> Evidence:
    return collect(windows, Hypothesis(World(cube)))


@pytest.fixture(scope="module")
def true(cube: ObjectModel, windows: Windows) -> Evidence:
    return collect(windows, Hypothesis(with_effect(cube, "friction", [0.3])))


def rows(evidence: Evidence, floor: Floor) -> Rows:
    return rows_of([(evidence, np.arange(COUNT))], floor)


def test_what_an_impact_gets_wrong_is_seen_after_it(cube: ObjectModel) -> None:
    """A missing bounce leaves nothing in flight before and little at the impact itself: most is in what follows it."""
    made = seen(World(cube.with_changes(restitution=0.5)), cube, COUNT, seed=4)
    windows = make_windows(made, cube)
    floor = noise_floor(windows)
    gap = measure_gap(made, rows(collect(windows, Hypothesis(World(cube))), floor), floor)
    assert gap.after_impacts.value > 0.6


def test_friction_closes_the_gap_that_it_makes(
    tosses: list[Toss], stated: Evidence, true: Evidence, floor: Floor
) -> None:
    assert floor.rms == pytest.approx(1.0, abs=0.1)
    before, after = rows(stated, floor), rows(true, floor)
    gap, left = (measure_gap(tosses, each, floor) for each in (before, after))
    assert gap.total.value > 2 * left.total.value
    assert gap.position_mm > left.position_mm > 0.1
    assert gap.rotation_deg > left.rotation_deg > 0.05
    assert sum(share.value for share in gap.by_phase.values()) == pytest.approx(1.0)
    assert sum(share.value for share in gap.by_channel.values()) == pytest.approx(1.0)
    assert gap.by_phase["slide"].value > 0.4
    assert share_closed_in(before, after, [Phase.SLIDE]) > 0.8
    assert share_closed_in(before, before, [Phase.SLIDE]) == 0.0
    assert is_clear(before, [Phase.SLIDE])
    assert not is_clear(after, [Phase.SLIDE])
    assert before.rms == pytest.approx(gap.total.value)
    assert phases_left(before, after) == {}
    assert "slide" in phases_left(before, before)
    assert "most in slide" in in_short(before)


def test_parts_judged_by_evidences_of_their_own_are_the_whole(
    tosses: list[Toss], stated: Evidence, floor: Floor
) -> None:
    numbers = [np.array([0, 3, 5]), np.array([1, 2, 4, 6, 7])]
    parts = [(stated.of_tosses(each), each) for each in numbers]
    whole, of_parts = rows(stated, floor), rows_of(parts, floor)
    assert of_parts.n == COUNT
    np.testing.assert_allclose(of_parts.by_toss(of_parts.raw**2), whole.by_toss(whole.raw**2))
    counted = stated.windows.counted
    assert len(whole.toss) == counted.sum()
    one = measure_gap(tosses, of_parts, floor)
    assert one.position_mm == pytest.approx(measure_gap(tosses, whole, floor).position_mm)


def test_a_toss_that_is_far_off_is_odd(tosses: list[Toss], stated: Evidence, floor: Floor) -> None:
    made = rows(stated, floor)
    far = made.whitened.copy()
    far[made.toss == 2] = 30.0
    changed = Rows(*(far if name == "whitened" else getattr(made, name) for name in made.__dataclass_fields__))
    assert measure_gap(tosses, changed, floor).odd == (tosses[2].name,)


def test_joints_are_channels() -> None:
    assert channels_of(7)[-1] == "joint_1"
