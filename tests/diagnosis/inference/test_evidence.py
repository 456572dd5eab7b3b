"""Evidence is a function of a hypothesis and a toss alone; fits recover what tosses were made with."""

from __future__ import annotations

import numpy as np
import pytest

from tests.diagnosis.by_hand import EFFECTS
from tests.diagnosis.conftest import FRICTION
from tossid.diagnosis.inference.evidence import collect, log_likelihood_ratio
from tossid.diagnosis.inference.fitting import fit
from tossid.diagnosis.inference.hypothesis import Hypothesis
from tossid.diagnosis.inference.sample import Sample, margin, reduces_deviance


def test_neither_what_was_computed_before_nor_another_toss_changes_it(slippery: Sample, stated: Hypothesis) -> None:
    right = stated.plus(EFFECTS["friction"], np.array([FRICTION]))
    once = collect(slippery.windows, right)
    far = collect(slippery.windows, stated.plus(EFFECTS["friction"], np.array([0.5])))
    again = collect(far.relinearised(right).windows, right)
    assert np.array_equal(once.log_likelihood, again.log_likelihood)
    assert np.array_equal(once.windows.at_v, again.windows.at_v)
    some = np.array([7, 2, 5])
    part, kept = slippery.of_tosses(some).evidence(stated), slippery.evidence(stated).of_tosses(some)
    assert np.array_equal(part.raw, kept.raw)
    assert np.array_equal(part.log_likelihood, kept.log_likelihood)


def test_windows_that_feel_no_difference_are_taken_over_and_not_simulated(slippery: Sample, stated: Hypothesis) -> None:
    known, right = collect(slippery.windows, stated), stated.plus(EFFECTS["friction"], np.array([FRICTION]))
    taken, anew = collect(slippery.windows, right, known=known), collect(slippery.windows, right)
    assert not slippery.windows.feels(right.world(), stated.world()).all()
    np.testing.assert_allclose(taken.log_likelihood, anew.log_likelihood, atol=1e-4)
    np.testing.assert_allclose(taken.windows.at_v, anew.windows.at_v, atol=1e-6)
    there, free = known.raw_residuals(stated.plus(EFFECTS["friction"], np.array([0.3]))), known.windows.free
    assert np.array_equal(there[free], known.raw[free])
    assert not np.array_equal(there[~free], known.raw[~free])


def test_noise_is_left_of_a_right_simulator_and_the_truth_is_likelier(slippery: Sample, stated: Hypothesis) -> None:
    wrong, right = (slippery.evidence(stated.plus(EFFECTS["friction"], np.array([mu]))) for mu in (0.18, FRICTION))
    size = np.sqrt(np.minimum(right.residuals[right.windows.inside] ** 2, 100).mean())
    assert 0.9 < size < 1.2
    gain = slippery.ratio(right, wrong)
    assert (gain > 0).mean() > 0.9
    assert np.allclose(log_likelihood_ratio(right, wrong), -log_likelihood_ratio(wrong, right))


def test_friction_is_recovered_from_what_is_stated(slippery: Sample, stated: Hypothesis) -> None:
    first = slippery.evidence(stated)
    made = fit(first, stated.plus(EFFECTS["friction"]), n=slippery.n, iterations=8, follow=1)
    value, error = (
        made.hypothesis.flat()[0],
        np.sqrt(made.columns.covariance()[0, 0]) * EFFECTS["friction"].parameters[0].step,
    )
    assert abs(value - FRICTION) < 3 * error
    assert error < 0.005
    assert made.wald("friction") > 60
    # one parameter of twelve tosses: each owes a little of its likelihood to its own part in the fit
    assert 0 < made.optimism().sum() < 5


def test_what_is_held_keeps_its_value(slippery: Sample, stated: Hypothesis) -> None:
    h = stated.plus(EFFECTS["gravity"], np.array([9.7])).plus(EFFECTS["friction"])
    made = fit(slippery.evidence(stated), h, n=slippery.n, iterations=3, held=frozenset({"gravity"}), follow=1)
    assert made.hypothesis.values_of("gravity").tolist() == [9.7]
    assert made.hypothesis.values_of("friction")[0] > 0.22
    assert made.columns_of("friction") == [0]


def test_an_effect_is_needed_where_it_is_there_and_not_where_it_is_not(slippery: Sample, stated: Hypothesis) -> None:
    both = stated.plus(EFFECTS["friction"], np.array([FRICTION])).plus(EFFECTS["cohesion"])
    made = slippery.refitted(slippery.evidence(both), both, iterations=3)
    there, not_there = (slippery.without(made, name) for name in ("friction", "cohesion"))
    assert slippery.gains(made, there).sum() > 100
    assert slippery.gains(made, not_there).sum() < 3
    first = slippery.evidence(stated)
    assert reduces_deviance(made.evidence, there.evidence, first)
    assert not reduces_deviance(made.evidence, not_there.evidence, first)


@pytest.mark.parametrize(("gain", "expected"), [([1.0, 3.0], 4.0), ([0.1, 0.1], 3.0), ([1.0], np.inf)])
def test_two_standard_errors_are_within_the_margin_and_three_at_least(gain: list[float], expected: float) -> None:
    assert margin(np.array(gain)) == pytest.approx(expected)
