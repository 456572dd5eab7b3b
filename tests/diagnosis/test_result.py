"""The whole result of a diagnosis in the form that gap.json has."""

from __future__ import annotations

import json
from dataclasses import replace

import pytest

from tests.diagnosis.by_hand import diagnosis, with_place, without_effects
from tossid.diagnosis.findings import Felt, Interval, Share
from tossid.objects import ObjectModel


def test_the_explanation_says_what_is_closed_and_what_is_not(cube: ObjectModel) -> None:
    made = replace(
        diagnosis(cube),
        unexplained=(Share("impact", Interval(0.07, 0.02, 0.12)),),
    )
    found = made.as_json()["explanation"]
    assert found["verdict"] == "explained"
    assert found["effects"] == ["friction"]
    assert found["unexplained_share"] == pytest.approx(1 - found["gap_closed"]["value"])
    assert found["unexplained_where"] == [{"phase": "impact", "share": 0.07, "ci95": [0.02, 0.12]}]
    assert (found["draws"], found["folds"], found["probability_none"]) == (800, 4, 0.0)


def test_what_to_change_and_what_that_brings_are_said(cube: ObjectModel) -> None:
    found = diagnosis(cube).as_json()
    (change,) = found["change"]
    assert change == {"name": "friction", "parameter": "mu", "from": 0.18, "to": 0.3, "ci95": [0.297, 0.303]}
    brings = found["brings"]
    assert brings["in"] == "tossid"
    assert brings["position_error_pct"]["before"] == pytest.approx(12.5)
    assert brings["position_error_mm"]["after"] == pytest.approx(0.003 * 104.8)
    assert brings["rotation_error_deg"]["after"] == pytest.approx(0.15)
    low, high = brings["position_error_pct"]["ci95"]["after"]
    assert low < brings["position_error_pct"]["after"] < high


def test_an_effect_that_whole_tosses_do_not_feel_is_minor(cube: ObjectModel) -> None:
    made = diagnosis(cube)
    friction = replace(made.findings[0], felt=Felt(0.4, 0.4))
    small = replace(made, findings=(friction, *made.findings[1:]))
    assert (made.named, made.candidates, made.minor) == (("friction",), (), ())
    assert (small.named, small.candidates, small.minor) == ((), (), ("friction",))
    unsure = replace(made, findings=(replace(made.findings[0], verdict="candidate"), *made.findings[1:]))
    assert (unsure.named, unsure.candidates) == ((), ("friction",))
    # what may be there in its place is not found beside it
    assert [f.name for f in made.found] == ["friction"]


def test_the_gap_is_given_by_phase_channel_corner_and_state(cube: ObjectModel) -> None:
    found = with_place(cube).as_json()
    gap = found["gap"]
    assert gap["total"] == {"value": 5.0, "ci95": [4.5, 5.5], "unit": "standard deviations of noise"}
    assert [row["phase"] for row in gap["by_phase"]] == ["flight", "impact", "slide", "roll", "rest"]
    assert sum(row["share"] for row in gap["by_channel"]) == pytest.approx(1.0)
    assert gap["position_mm"] == pytest.approx(1.0)
    assert len(gap["by_corner"]) == len(found["gap_left"]["by_corner"]) == 8
    assert [row["phase"] for row in gap["wrench"]] == ["flight", "contact"]
    assert [row["phase"] for row in found["gap_left"]["wrench"]] == ["flight"]
    assert json.loads(json.dumps(found, allow_nan=False)) == found


def test_the_unexplained_share_is_never_negative(cube: ObjectModel) -> None:
    over = replace(diagnosis(cube), gap_closed=Interval(1.04, 0.9, 1.1))
    assert over.as_json()["explanation"]["unexplained_share"] == 0.0
    nothing = without_effects(cube, "unexplained").as_json()
    assert nothing["explanation"]["unexplained_share"] == 1.0
    assert nothing["explanation"]["effects"] == []


def test_its_main_numbers_are_flat_and_finite(cube: ObjectModel) -> None:
    made = diagnosis(cube)
    found = made.metrics()
    assert (found["gap_total"], found["n_effects"]) == (5.0, 1.0)
    assert found["gap_closed"] == made.gap_closed.value
    assert found["position_error_pct/after"] == pytest.approx(0.3)
    assert any(name.startswith("friction/") for name in found)
    unknown = replace(made, gap_closed=Interval(float("nan"), 0.0, 1.0)).metrics()
    assert "gap_closed" not in unknown
