"""What is said of single effects, beyond what a whole diagnosis shows."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tests.diagnosis.by_hand import EFFECTS, finding
from tossid.diagnosis.effect_findings import changes, hidden, phases_of, size_of
from tossid.diagnosis.findings import Felt, Interval


def test_what_whole_tosses_feel_most_is_changed_first() -> None:
    one = Interval(1.0, 0.9, 1.1)
    small = finding(EFFECTS["gravity"], "identified", parameters={"g_ms2": one}, felt=Felt(0.4, 0.8))
    large = finding(EFFECTS["friction"], "candidate", parameters={"mu": one}, felt=Felt(3.0, 0.1))
    minor = finding(EFFECTS["magnus"], "identified", parameters={"c_ns2pm": one}, felt=Felt(0.4, 0.4))
    found = changes([small, minor, large])
    assert [(each.name, each.parameter, each.stated) for each in found] == [
        ("friction", "mu", 0.18),
        ("gravity", "g_ms2", 9.81),
    ]
    assert changes([replace(small, felt=None)]) == ()


def test_a_percent_counts_as_much_as_a_degree() -> None:
    assert size_of(Felt(2.0, 1.0)) == size_of(Felt(1.0, 2.0)) == 2.0
    assert size_of(None) == 0.0
    assert size_of(Felt(np.inf, 0.0)) == np.inf


def test_what_a_plane_hides_is_not_identifiable() -> None:
    found = hidden(EFFECTS["wind"])
    assert found.verdict == "not_identifiable"
    assert found.parameters == {}
    assert found.phases == phases_of(EFFECTS["wind"])
