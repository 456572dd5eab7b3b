"""Ranks of true values are uniform where intervals are right, and told from it where they are not."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.stats import kstest
from scipy.stats import t as student

from tossid.diagnosis.audit.ranks import band, joint_rank, rank, ranks_of, summarise_ranks, within

CASES = 400
CORRELATION = np.array([[1.0, 0.9], [0.9, 1.0]])


def stated(value: float, error: float, freedom: float) -> dict[str, Any]:
    half = error * student.ppf(0.975, freedom)
    return {"value": value, "ci95": [value - half, value + half]}


def scores(seed: int, too_narrow: float = 1.0, related: float = 0.9) -> list[dict[str, Any]]:
    """Two parameters a case, estimated with correlated errors; their intervals may be too narrow."""
    rng, out = np.random.default_rng(seed), []
    for _ in range(CASES):
        freedom = 18.0
        off = np.linalg.cholesky(CORRELATION) @ rng.standard_normal(2) / np.sqrt(rng.chisquare(freedom) / freedom)
        ranks = [rank(1.0, stated(1.0 + float(x), 1.0 / too_narrow, freedom), freedom) for x in off]
        assert None not in ranks
        correlation = [[1.0, related], [related, 1.0]]
        parameters = [{"rank": each, "led": True, "covered": abs(2 * (each or 0.0) - 1) <= 0.95} for each in ranks]
        out.append({"parameters": parameters, "joint_ranks": [joint_rank([r or 0.0 for r in ranks], correlation, rng)]})
    return out


def test_right_intervals_give_uniform_ranks_of_values_and_of_effects() -> None:
    found = summarise_ranks(scores(0))
    assert found["coverage_50"]["share"] == pytest.approx(0.5, abs=0.06)
    assert found["coverage_90"]["share"] == pytest.approx(0.9, abs=0.04)
    assert found["coverage_led"]["share"] == pytest.approx(0.95, abs=0.03)
    assert found["coverage_behind"]["of"] == 0
    assert found["ranks_uniform"]["value"] > 0.05
    assert found["joint_ranks_uniform"]["value"] > 0.01


def test_intervals_that_are_too_narrow_are_told() -> None:
    found = summarise_ranks(scores(1, too_narrow=2.0))
    assert found["coverage_90"]["share"] < 0.75
    assert found["ranks_uniform"]["value"] < 0.01
    assert found["joint_ranks_uniform"]["value"] < 0.01


def test_a_wrong_correlation_shows_in_whole_effects_only() -> None:
    found = summarise_ranks(scores(2, related=-0.9))
    assert found["ranks_uniform"]["value"] > 0.01
    assert found["joint_ranks_uniform"]["value"] < 1e-6


def test_a_rank_takes_the_end_that_no_bound_has_drawn_in() -> None:
    whole = {"value": 0.1, "ci95": [-0.1, 0.3]}
    assert rank(0.05, {"value": 0.1, "ci95": [0.0, 0.3]}, 20.0) == pytest.approx(rank(0.05, whole, 20.0))
    assert rank(0.3, whole, 20.0) == pytest.approx(0.975)
    assert rank(0.1, {"value": 0.1, "ci95": [0.1, 0.1]}, 20.0) is None
    assert rank(0.1, {"value": 0.1, "ci95": [None, None]}, 20.0) is None


def test_narrower_intervals_hold_fewer_ranks() -> None:
    assert within([0.5, 0.8, 0.96], 0.5) == [True, False, False]
    assert within([0.5, 0.8, 0.96], 0.95) == [True, True, True]


def test_uniform_numbers_stay_in_the_band_as_often_as_stated() -> None:
    rng, n = np.random.default_rng(3), 50
    outside = sum(kstest(rng.uniform(size=n), "uniform").statistic > band(n) for _ in range(400))
    assert outside / 400 == pytest.approx(0.05, abs=0.03)


def test_ranks_are_of_those_that_lead_or_of_the_others() -> None:
    parameters = [{"rank": 0.2, "led": True}, {"rank": 0.7, "led": False}, {"rank": None, "led": True}]
    assert ranks_of(parameters).tolist() == [0.2, 0.7]
    assert ranks_of(parameters, led=True).tolist() == [0.2]
