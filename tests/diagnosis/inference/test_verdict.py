"""Each row of the tables of verdicts."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest

from tossid.diagnosis.findings import Interval
from tossid.diagnosis.inference.verdict import (
    NO_NOISE,
    Facts,
    Felt,
    verdict_of_found,
    verdict_of_gap,
    verdict_of_others,
)

SURE = Facts(Felt(3.0, 2.0), (), 1.0, True, 0.9)
CLOSED = Interval(0.9, 0.8, 1.0)


@pytest.mark.parametrize(
    ("changes", "verdict"),
    [
        ({}, "identified"),
        ({"alike": ("cohesion",)}, "confusable"),
        ({"frequency": 0.89}, "candidate"),
        ({"improves": False}, "candidate"),
        ({"closes": 0.4}, "candidate"),
        ({"alike": ("cohesion",), "frequency": 0.5}, "candidate"),
        ({"felt": Felt(0.4, 0.4)}, "minor"),
        ({"felt": Felt(0.4, 0.6)}, "identified"),
        ({"felt": Felt(0.4, 0.4), "frequency": 0.1}, "minor"),
    ],
)
def test_an_effect_that_was_found(changes: dict[str, Any], verdict: str) -> None:
    assert verdict_of_found(replace(SURE, **changes)) == verdict


def test_an_effect_that_was_not_found_would_have_been_or_not() -> None:
    ranges = {"x_m": 0.08, "c_nspm": 2.0}
    assert verdict_of_others({"x_m": 0.001, "c_nspm": float("inf")}, ranges) == "not_supported"
    assert verdict_of_others({"x_m": 0.02, "c_nspm": float("inf")}, ranges) == "not_identifiable"


@pytest.mark.parametrize(
    ("changes", "verdict"),
    [
        ({}, "explained"),
        ({"left": Felt(0.6, 0.2)}, "partly_explained"),
        ({"left": Felt(0.6, 0.2), "noise": Felt(0.7, 0.3)}, "explained"),
        ({"left": Felt(0.6, 0.2), "closed": Interval(0.3, 0.1, 0.5)}, "unexplained"),
        ({"found": False}, "unexplained"),
        ({"found": False, "within_solvers": True}, "within_solver_disagreement"),
        ({"found": False, "gap_over_floor": 1.1}, "no_gap"),
    ],
)
def test_the_whole_gap(changes: dict[str, Any], verdict: str) -> None:
    known: dict[str, Any] = {
        "found": True,
        "gap_over_floor": 4.0,
        "left": Felt(0.3, 0.2),
        "noise": NO_NOISE,
        "closed": CLOSED,
        "within_solvers": False,
    }
    assert verdict_of_gap(**(known | changes)) == verdict
