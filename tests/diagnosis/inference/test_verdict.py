"""Each row of the tables of verdicts."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest

from tossid.diagnosis.findings import Interval
from tossid.diagnosis.inference.verdict import (
    Facts,
    verdict_of_found,
    verdict_of_gap,
    verdict_of_others,
)

SURE = Facts((), 1.0, False, 0.9)
CLOSED = Interval(0.9, 0.8, 1.0)


@pytest.mark.parametrize(
    ("changes", "verdict"),
    [
        ({}, "identified"),
        ({"alike": ("cohesion",)}, "confusable"),
        ({"frequency": 0.89}, "candidate"),
        ({"worsens": True}, "candidate"),
        ({"closes": 0.4}, "candidate"),
        ({"alike": ("cohesion",), "frequency": 0.5}, "candidate"),
        ({"frequency": None}, "identified"),
        ({"holds": False}, "candidate"),
    ],
)
def test_an_effect_that_was_found(changes: dict[str, Any], verdict: str) -> None:
    assert verdict_of_found(replace(SURE, **changes)) == verdict


def test_an_effect_that_was_not_found_would_have_been_or_not() -> None:
    ranges = {"x_m": 0.08, "c_nspm": 2.0}
    assert verdict_of_others({"x_m": 0.004}, ranges) == "not_supported"
    assert verdict_of_others({"x_m": 0.08}, ranges) == "not_identifiable"
    assert verdict_of_others({}, ranges) == "not_identifiable"


@pytest.mark.parametrize(
    ("changes", "verdict"),
    [
        ({}, "explained"),
        ({"felt": True}, "partly_explained"),
        ({"sure": False}, "partly_explained"),
        ({"sure": False, "closed": Interval(0.3, 0.1, 0.5)}, "unexplained"),
        ({"felt": True, "closed": Interval(0.3, 0.1, 0.5)}, "unexplained"),
        ({"found": False}, "unexplained"),
        ({"found": False, "within_solvers": True}, "within_solver_disagreement"),
        ({"found": False, "gap_over_floor": 1.1}, "no_gap"),
    ],
)
def test_the_whole_gap(changes: dict[str, Any], verdict: str) -> None:
    known: dict[str, Any] = {
        "found": True,
        "sure": True,
        "gap_over_floor": 4.0,
        "felt": False,
        "closed": CLOSED,
        "within_solvers": False,
    }
    assert verdict_of_gap(**(known | changes)) == verdict
