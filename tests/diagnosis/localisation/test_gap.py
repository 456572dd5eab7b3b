"""The gap: 1 at the truth, above it elsewhere, with shares that add up; its floor is the noise that flight shows."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.diagnosis.tossed import seen, with_effect
from tossid.diagnosis.inference.evidence import Evidence, collect
from tossid.diagnosis.inference.hypothesis import Hypothesis
from tossid.diagnosis.likelihood.density import student_deviance
from tossid.diagnosis.likelihood.windows import Windows, make_windows
from tossid.diagnosis.localisation.gap import (
    Rows,
    in_short,
    is_clear,
    measure_gap,
    phases_left,
    rows_of,
    share_closed_in,
)
from tossid.diagnosis.localisation.noise import Floor, expected_deviance, measure_noise, noise_floor
from tossid.objects import ObjectModel
from tossid.physics.effects import Forces, World
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


def test_parts_judged_by_evidences_of_their_own_are_the_whole_and_a_toss_far_off_is_odd(
    tosses: list[Toss], stated: Evidence, floor: Floor
) -> None:
    numbers = [np.array([0, 3, 5]), np.array([1, 2, 4, 6, 7])]
    whole, of_parts = rows(stated, floor), rows_of([(stated.of_tosses(each), each) for each in numbers], floor)
    assert of_parts.n == COUNT
    assert len(whole.toss) == stated.windows.counted.sum()
    np.testing.assert_allclose(of_parts.by_toss(of_parts.raw**2), whole.by_toss(whole.raw**2))
    one, other = (measure_gap(tosses, each, floor) for each in (of_parts, whole))
    assert one.position_mm == pytest.approx(other.position_mm)
    far = np.where((whole.toss == 2)[:, None], 30.0, whole.whitened)
    assert measure_gap(tosses, replace(whole, whitened=far), floor).odd == (tosses[2].name,)


# ---------------------------------------------------------------- the floor


@pytest.mark.parametrize("std", [0.5, 1.0, 2.0])
def test_expected_deviance_is_the_mean_over_draws(std: float) -> None:
    drawn = student_deviance(std * np.random.default_rng(0).normal(size=400_000)).mean()
    assert expected_deviance(std) == pytest.approx(float(drawn), rel=0.01)


def test_noise_is_measured_whatever_forces_act_and_sets_the_floor(cube: ObjectModel) -> None:
    made = seen(World(cube, gravity=8.0, forces=Forces(quadratic=0.05)), cube, 24, seed=8)
    for stated_over_true, floor_rms in ((1.0, 1.0), (0.5, 2.0), (2.0, 1.0)):
        stating = [replace(toss, q_cov=toss.q_cov * stated_over_true**2) for toss in made]
        floor = noise_floor(make_windows(stating, cube))
        for found in (floor.noise.position, floor.noise.rotation):
            assert found == pytest.approx(1 / stated_over_true, rel=0.125)
        assert floor.rms == pytest.approx(floor_rms, rel=0.125)
        assert floor.deviance.shape == (6,)
        assert floor.deviance[0] >= expected_deviance(1.0)


def test_no_flight_no_measurement(windows: Windows) -> None:
    grounded = windows.rows(np.flatnonzero(~windows.free))
    assert measure_noise(grounded).as_json() == {"position_over_stated": None, "rotation_over_stated": None}
    assert noise_floor(grounded).rms == 1.0
