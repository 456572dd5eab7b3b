"""What a witness says in gap.json."""

from __future__ import annotations

from dataclasses import replace

from tossid.diagnosis.findings import Interval
from tossid.diagnosis.witness import Witness


def test_a_witness_has_the_stated_the_found_the_measured_and_the_made_value() -> None:
    said = Witness("restitution", "restitution", 0.0, 0.31, Interval(0.3, 0.25, 0.35), 7)
    found = said.as_json()
    assert (found["stated"], found["found"], found["measured"]["value"]) == (0.0, 0.31, 0.3)
    assert (found["predicted"], found["contradicts"]) == (None, False)
    made = replace(said, predicted=Interval(0.4, 0.38, 0.42), contradicts=True).as_json()
    assert made["predicted"] == {"value": 0.4, "ci95": [0.38, 0.42]}
    assert made["contradicts"]
