"""The verdict follows from what is left over the floor, and from how much of the gap is closed."""

from __future__ import annotations

import pytest

from tests.diagnosis.by_hand import gap
from tossid.diagnosis.attribution import whole_verdict
from tossid.diagnosis.findings import Interval, Share

SOME = Share("slide", Interval(0.2, 0.1, 0.3))


@pytest.mark.parametrize(
    ("before", "after", "closed", "unnamed", "unexplained", "named", "verdict"),
    [
        (1.02, 1.02, 0.0, (), (), False, "no_gap"),
        (3.0, 3.0, 0.0, (), (), False, "unexplained"),
        (1.02, 1.0, 0.9, ("vortex",), (), False, "unexplained"),  # something is there, and has no name
        (3.0, 1.01, 0.99, (), (), True, "explained"),
        (3.0, 1.01, 0.7, (), (SOME,), True, "explained"),
        (9.0, 1.5, 0.95, (), (), True, "explained"),
        (9.0, 1.5, 0.95, (), (SOME,), True, "partly_explained"),
        (3.0, 1.01, 0.99, ("vortex",), (), True, "partly_explained"),
        (3.0, 2.0, 0.6, (), (SOME,), True, "partly_explained"),
        (3.0, 2.5, 0.3, (), (SOME,), True, "unexplained"),
        # a small gap is near its floor however little of it is closed
        (1.025, 1.01, 0.3, (), (SOME,), True, "unexplained"),
    ],
)
def test_verdict(
    before: float,
    after: float,
    closed: float,
    unnamed: tuple[str, ...],
    unexplained: tuple[Share, ...],
    named: bool,
    verdict: str,
) -> None:
    share = Interval(closed, closed - 0.05, closed + 0.05)
    found = whole_verdict(gap(before, n=8), gap(after, n=8), share, unnamed, unexplained, any_named=named)
    assert found == verdict
