"""Evidence is a function of a hypothesis and a toss: of nothing that was computed before, and of no other toss."""

from __future__ import annotations

import numpy as np

from tests.diagnosis.by_hand import EFFECTS
from tests.diagnosis.inference.conftest import FRICTION
from tossid.diagnosis.inference.evidence import collect, log_likelihood_ratio
from tossid.diagnosis.inference.hypothesis import Hypothesis
from tossid.diagnosis.inference.sample import Sample


def test_nothing_that_was_computed_before_changes_it(slippery: Sample, stated: Hypothesis) -> None:
    right = stated.plus(EFFECTS["friction"], np.array([FRICTION]))
    once = collect(slippery.windows, right)
    far = collect(slippery.windows, stated.plus(EFFECTS["friction"], np.array([0.5])))
    again = collect(far.relinearised(right).windows, right)
    assert np.array_equal(once.log_likelihood, again.log_likelihood)
    assert np.array_equal(once.windows.at_v, again.windows.at_v)


def test_windows_that_feel_no_difference_may_be_taken_over(slippery: Sample, stated: Hypothesis) -> None:
    known, right = collect(slippery.windows, stated), stated.plus(EFFECTS["friction"], np.array([FRICTION]))
    taken, anew = collect(slippery.windows, right, known=known), collect(slippery.windows, right)
    assert not slippery.windows.feels(right.world(), stated.world()).all()
    np.testing.assert_allclose(taken.log_likelihood, anew.log_likelihood, atol=1e-4)
    np.testing.assert_allclose(taken.windows.at_v, anew.windows.at_v, atol=1e-6)


def test_no_other_toss_changes_it(slippery: Sample, stated: Hypothesis) -> None:
    whole, some = slippery.evidence(stated), np.array([7, 2, 5])
    part = slippery.of_tosses(some).evidence(stated)
    kept = whole.of_tosses(some)
    assert np.array_equal(part.raw, kept.raw)
    assert np.array_equal(part.log_likelihood, kept.log_likelihood)


def test_noise_is_left_of_a_right_simulator_and_the_truth_is_likelier(slippery: Sample, stated: Hypothesis) -> None:
    wrong, right = (slippery.evidence(stated.plus(EFFECTS["friction"], np.array([mu]))) for mu in (0.18, FRICTION))
    size = np.sqrt(np.minimum(right.residuals[right.windows.inside] ** 2, 100).mean())
    assert 0.9 < size < 1.2
    gain = slippery.ratio(right, wrong)
    assert (gain > 0).mean() > 0.9
    assert np.allclose(log_likelihood_ratio(right, wrong), -log_likelihood_ratio(wrong, right))


def test_windows_that_cannot_feel_a_difference_are_not_simulated(slippery: Sample, stated: Hypothesis) -> None:
    e = slippery.evidence(stated)
    there = e.raw_residuals(stated.plus(EFFECTS["friction"], np.array([0.3])))
    free = e.windows.free
    assert np.array_equal(there[free], e.raw[free])
    assert not np.array_equal(there[~free], e.raw[~free])
