"""The parts of a result in the form that gap.json has."""

from __future__ import annotations

import json

from tests.diagnosis.by_hand import EFFECTS, finding, with_place
from tossid.diagnosis.findings import Consequence, Corner, Interval, Step
from tossid.objects import ObjectModel

ONE = Interval(1.0, 0.5, 1.5)


def test_an_interval_is_a_value_with_its_ends() -> None:
    assert ONE.as_json() == {"value": 1.0, "ci95": [0.5, 1.5]}


def test_a_relation_is_written_with_five_points_of_its_curve(cube: ObjectModel) -> None:
    (relation, _) = with_place(cube).place.wrench
    found = relation.as_json()
    assert len(found["curve"]) == 5
    states = [point["state"] for point in found["curve"]]
    assert states == sorted(states)
    assert (states[0], states[-1]) == (relation.curve[0, 0], relation.curve[-1, 0])
    assert found["component"] == relation.component
    json.dumps(found, allow_nan=False)


def test_a_corner_that_never_touches_has_no_share_per_frame() -> None:
    found = Corner((0.05, -0.05, 0.05), ONE, 0, None).as_json()
    assert found == {
        "corner": [0.05, -0.05, 0.05], "link": 0, "share": 1.0, "ci95": [0.5, 1.5], "frames": 0, "per_frame": None,
    }  # fmt: skip


def test_an_effect_is_written_with_all_that_was_found_of_it() -> None:
    made = finding(EFFECTS["friction"], "identified", parameters={"mu": ONE}, gap_closed=ONE)
    found = made.as_json()
    assert (found["name"], found["verdict"]) == ("friction", "identified")
    assert found["parameters"] == {"mu": ONE.as_json()}
    assert found["gap_closed"] == ONE.as_json()
    assert found["detectable"].keys() == {parameter.name for parameter in EFFECTS["friction"].parameters}
    assert found["phases"]


def test_errors_on_unseen_tosses_are_null_where_there_are_none() -> None:
    seen = Step(("friction",), ONE, ONE, ONE)
    assert seen.as_json()["unseen_position_error_pct"] is None
    assert Step((), ONE, ONE, ONE, ONE, ONE).as_json()["unseen_rotation_error_deg"] == ONE.as_json()


def test_a_headline_is_found_and_matters() -> None:
    friction = EFFECTS["friction"]
    assert finding(friction, "identified").headline
    assert not finding(friction, "not_supported").headline
    for matters in (True, False):
        found = finding(friction, "confusable", consequence=Consequence(0.1, 0.2, 0.01, matters))
        assert found.headline == matters
        assert found.as_json()["matters"] == matters
        assert found.as_json()["whole_tosses"] == {"position_pct": 0.1, "rotation_deg": 0.2}
