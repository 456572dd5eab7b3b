"""A row of the experiment has what comes back of the truth."""

from __future__ import annotations

import pytest

from pipelines.tools.experiments.simulated.known_object import FRICTION, HEADS, row


def test_a_row_has_the_friction_that_comes_back_and_counts_of_intervals() -> None:
    found = dict(zip(HEADS[:5], row("lcp", "none", "cn", seeds=1, tosses=12)[:5], strict=True))
    assert (found["engine"], found["noise"], found["model"]) == ("lcp", "none", "cn")
    assert float(found["friction"].split()[0]) == pytest.approx(FRICTION, rel=0.05)
    assert found["intervals"].endswith("of 1")
