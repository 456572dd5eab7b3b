"""Ranks of true values are probabilities, and uneven ones are found."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import t as student

from tossid.audit.ranks import rank, uniform_p, within


def test_ends_of_a_95_percent_interval_have_the_ranks_of_its_quantiles() -> None:
    stated = {"value": 2.0, "ci95": [1.0, 3.0]}
    for true, expected in ((1.0, 0.025), (2.0, 0.5), (3.0, 0.975)):
        assert rank(true, stated, 12.0) == pytest.approx(expected)


def test_an_end_that_was_drawn_in_is_as_far_away_as_the_other() -> None:
    assert rank(0.3, {"value": 0.1, "ci95": [0.0, 0.3]}, 20.0) == pytest.approx(0.975)


def test_without_an_interval_there_is_no_rank() -> None:
    assert rank(1.0, {"value": 1.0, "ci95": [None, None]}, 9.0) is None
    assert rank(1.0, {"value": 1.0, "ci95": [1.0, 1.0]}, 9.0) is None


def test_right_intervals_have_uniform_ranks_and_narrow_ones_do_not() -> None:
    rng, freedom, half = np.random.default_rng(1), 15.0, student.ppf(0.975, 15.0)
    errors = rng.standard_t(freedom, 300)
    ranks = {
        width: [rank(0.0, {"value": e, "ci95": [e - width * half, e + width * half]}, freedom) or 0.0 for e in errors]
        for width in (1.0, 0.5)
    }
    assert np.mean(within(ranks[1.0], 0.5)) == pytest.approx(0.5, abs=0.08)
    assert np.mean(within(ranks[1.0], 0.9)) == pytest.approx(0.9, abs=0.05)
    right, narrow = (uniform_p([[each] for each in ranks[width]]) for width in (1.0, 0.5))
    assert right is not None
    assert narrow is not None
    assert right > 0.05
    assert narrow < 1e-6
    assert uniform_p([[], []]) is None
