"""Reported values are roots of the estimating equations, and their intervals know where windows begin."""

from __future__ import annotations

import numpy as np
import pytest

from tests.diagnosis.by_hand import EFFECTS
from tests.diagnosis.inference.conftest import FRICTION
from tests.diagnosis.tossed import seen, with_effect
from tossid.diagnosis.inference.final_values import (
    DEGREES,
    FINER,
    NEAR,
    SHIFTS,
    final_values,
    root_of,
    with_finer_steps,
)
from tossid.diagnosis.inference.fitting import fit
from tossid.diagnosis.inference.hypothesis import Hypothesis
from tossid.diagnosis.problem import Problem
from tossid.objects import ObjectModel
from tossid.physics.effects import World


def problem_with(cube: ObjectModel, name: str, values: list[float]) -> Problem:
    tosses = seen(with_effect(cube, name, values), cube, 9, seed=3, frames=70)
    return Problem(tosses, Hypothesis(World(cube)), library=(EFFECTS[name],))


def test_final_values_are_at_a_root_and_have_the_variance_over_shifts(cube: ObjectModel) -> None:
    problem = problem_with(cube, "friction", [FRICTION])
    found = problem.search().run()
    shifted = [problem.shifted(share) for share in SHIFTS]
    assert all(len(s.windows.toss) != len(problem.sample.windows.toss) or s.windows.first.min() > 0 for s in shifted)
    final = final_values(found, shifted)
    assert final.found.fit.evidence.windows.settings.simulation.substeps == FINER * 2
    variance = final.variance["friction"]
    assert variance.shape == (1,)
    assert 0 < np.sqrt(variance[0]) < 0.01
    fit = final.found.fit
    plain, wider = fit.intervals("friction")["mu"], fit.intervals("friction", variance, DEGREES)["mu"]
    assert wider.low < plain.low < plain.value < plain.high < wider.high
    # a variance of two degrees of freedom alone has their quantile, 4.3
    alone = fit.intervals("friction", np.array([1e-3**2 * 1e4]), DEGREES)["mu"]
    assert alone.high - alone.value == pytest.approx(4.303 * 0.1, rel=0.02)
    assert wider.low < FRICTION < wider.high


def test_a_root_is_found_from_off_it(cube: ObjectModel) -> None:
    problem = problem_with(cube, "friction", [FRICTION])
    off = problem.stated.plus(EFFECTS["friction"], np.array([FRICTION + 0.003]))
    evidence = problem.sample.evidence(off)
    root = root_of(fit(evidence, off, n=len(problem.tosses), iterations=0), evidence)
    error = np.sqrt(np.diag(root.columns.covariance()))
    assert abs(root.columns.step() / error)[0] < 3 * NEAR
    assert abs(root.hypothesis.flat()[0] - FRICTION) < 0.5 * abs(off.flat()[0] - FRICTION)


def test_shorter_time_steps_change_predictions_by_less_than_noise(cube: ObjectModel) -> None:
    problem = problem_with(cube, "friction", [FRICTION])
    coarse = problem.sample.evidence(problem.stated.plus(EFFECTS["friction"], np.array([FRICTION])))
    fine = with_finer_steps(coarse)
    apart = np.abs(fine.raw - coarse.raw).max((1, 2))
    assert apart.max() > 1e-6
    assert np.median(apart) < 1.5e-4  # of the poses' noise, in metres and radians


def test_what_flight_has_determined_keeps_its_values(cube: ObjectModel) -> None:
    problem = problem_with(cube, "gravity", [9.5])
    found = problem.search().run()
    assert found.flown == {"gravity"}
    final = final_values(found, (problem.shifted(share) for share in SHIFTS))
    assert final.found is found
    assert final.variance == {}
