"""Reported values are roots of the estimating equations, and their intervals know how flat these are."""

from __future__ import annotations

import numpy as np
import pytest

from tests.diagnosis.by_hand import EFFECTS
from tests.diagnosis.inference.conftest import FRICTION
from tests.diagnosis.tossed import seen, with_effect
from tossid.diagnosis.inference.final_values import DEGREES, FINER, SHIFTS, final_values, precise, roots_between
from tossid.diagnosis.inference.fitting import fit
from tossid.diagnosis.inference.found import Found
from tossid.diagnosis.inference.hypothesis import Hypothesis
from tossid.diagnosis.inference.sample import Sample
from tossid.diagnosis.problem import Problem
from tossid.objects import ObjectModel
from tossid.physics.effects import World


def problem_with(cube: ObjectModel, name: str, values: list[float]) -> Problem:
    tosses = seen(with_effect(cube, name, values), cube, 9, seed=3, frames=70)
    return Problem(tosses, Hypothesis(World(cube)), library=(EFFECTS[name],))


def placements(problem: Problem) -> list[Sample]:
    return [problem.sample, *map(problem.shifted, SHIFTS)]


def test_final_values_hold_the_truth_though_the_fit_was_off_it(cube: ObjectModel) -> None:
    problem = problem_with(cube, "friction", [FRICTION])
    samples = placements(problem)
    assert all(len(s.windows.toss) != len(samples[0].windows.toss) or s.windows.first.min() > 0 for s in samples[1:])
    off = problem.stated.plus(EFFECTS["friction"], np.array([FRICTION + 0.003]))
    fitted = fit(problem.sample.evidence(off), off, n=len(problem.tosses), iterations=0)
    final = final_values(Found(problem.sample.evidence(problem.stated), fitted, None, ()), samples)
    there, variance = final.found.fit, final.variance["friction"]
    assert there.evidence.windows.settings.simulation.substeps == FINER * 2
    assert variance.shape == (1,)
    assert 0 < np.sqrt(variance[0]) < 0.01
    plain, wider = there.intervals("friction")["mu"], there.intervals("friction", variance, DEGREES)["mu"]
    assert wider.low < plain.low < plain.value < plain.high < wider.high
    assert wider.low < FRICTION < wider.high
    assert abs(plain.value - FRICTION) < 0.5 * 0.003
    # where steps are a share of a parameter's change, the jackknife is wider by that share
    alone = fit(there.evidence, there.hypothesis, n=there.n, iterations=0, sizes=there.sizes).intervals("friction")
    assert plain.high - plain.low > alone["mu"].high - alone["mu"].low
    # a variance of two degrees of freedom alone has their quantile, 4.3
    alone = there.intervals("friction", np.array([1e-3**2 * 1e4]), DEGREES)
    assert alone["mu"].high - alone["mu"].value == pytest.approx(4.303 * 0.1, rel=0.02)


@pytest.mark.parametrize("ends", [(-3.0, 5.0), (1.0, 5.0)])
def test_roots_of_linear_steps_are_found_where_a_bound_is_in_the_way_too(ends: tuple[float, float]) -> None:
    """Steps that go a quarter and half of the way to 2 and -1, from ends that need not lie alike about either."""
    values = np.array([[[ends[0], 4.0], [ends[1], -2.0]]])
    found, share = roots_between(values, np.array([0.25, 0.5]) * (np.array([2.0, -1.0]) - values))
    np.testing.assert_allclose(found, [[2.0, -1.0]])
    np.testing.assert_allclose(share, [0.25, 0.5])


def test_scaled_columns_have_the_covariance_of_scaled_derivatives(cube: ObjectModel) -> None:
    problem = problem_with(cube, "friction", [FRICTION])
    h = problem.stated.plus(EFFECTS["friction"], np.array([FRICTION]))
    columns = fit(problem.sample.evidence(h), h, n=len(problem.tosses), iterations=0).columns
    scaled = columns.scaled(np.array([0.25]))
    assert scaled.step() == pytest.approx(4 * columns.step(), rel=1e-6)
    assert scaled.covariance() == pytest.approx(16 * columns.covariance(), rel=1e-6)
    assert scaled.gains(scaled.step()) == pytest.approx(columns.gains(columns.step()), rel=1e-6)


def test_shorter_time_steps_change_predictions_by_less_than_noise(cube: ObjectModel) -> None:
    problem = problem_with(cube, "friction", [FRICTION])
    coarse = problem.sample.evidence(problem.stated.plus(EFFECTS["friction"], np.array([FRICTION])))
    fine = precise(coarse)
    apart = np.abs(fine.raw - coarse.raw).max((1, 2))
    assert apart.max() > 1e-6
    assert np.median(apart) < 1.5e-4  # of the poses' noise, in metres and radians


def test_what_flight_has_determined_keeps_its_values(cube: ObjectModel) -> None:
    problem = problem_with(cube, "gravity", [9.5])
    found = problem.search().run()
    assert found.flown == {"gravity"}
    final = final_values(found, placements(problem))
    assert final.found is found
    assert final.variance == {}
