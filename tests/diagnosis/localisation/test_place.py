"""Where the gap is, in the form that gap.json has."""

from __future__ import annotations

import json

from tests.diagnosis.by_hand import with_place
from tossid.diagnosis.findings import Interval
from tossid.diagnosis.localisation.place import Corner
from tossid.objects import ObjectModel

ONE = Interval(1.0, 0.5, 1.5)


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
