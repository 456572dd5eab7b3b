"""Answers made by hand are scored as they should be."""

from __future__ import annotations

import pytest

from tests.audit.answers import answer, truth
from tossid.audit.scores import MEASURES, score, summarise

FRICTION = truth("effect", friction={"mu": 0.3})


def test_the_right_name_first() -> None:
    found = score(FRICTION, answer("friction", friction={"parameters": {"mu": (0.29, 0.31, 0.33)}}))
    assert found["right"]
    assert found["false"] == found["missed"] == []
    (parameter,) = found["parameters"]
    assert parameter["covered"]
    assert 0.025 < parameter["rank"] < 0.5
    assert found["error_closed"] == pytest.approx(0.95)
    assert found["phase_right"]


def test_a_class_of_three_counts_and_one_of_four_does_not() -> None:
    assert score(FRICTION, answer("cohesion", cohesion={"classes": ("friction", "adhesion")}, friction={}))["right"]
    found = score(FRICTION, answer("cohesion", cohesion={"classes": ("adhesion", "restitution", "friction")}))
    assert not found["right"]
    assert found["missed"] == ["friction"]


def test_the_right_name_second_is_wrong_and_the_first_is_false() -> None:
    found = score(FRICTION, answer("magnus", "friction"))
    assert not found["right"]
    assert found["false"] == ["magnus"]


def test_a_candidate_is_no_name() -> None:
    found = score(FRICTION, answer(candidates=("friction",)))
    assert (found["right"], found["right_or_candidate"]) == (False, True)
    assert found["candidates"] == {"friction": ["friction"]}
    alike = answer(candidates=("cohesion",), cohesion={"classes": ("friction",)})
    assert score(FRICTION, alike)["right_or_candidate"]
    assert not score(FRICTION, answer("magnus", candidates=("wind",)))["right_or_candidate"]


def test_a_right_name_that_is_too_small_to_matter_counts_unless_it_is_not_sure() -> None:
    gravity = {"classes": ("length_scale",), "parameters": {"g_ms2": (9.7, 9.8, 9.9)}}
    said = answer(minor=("gravity",), verdict="no_gap", gravity=gravity)
    found = score(truth("effect", gravity={"g_ms2": 9.79}), said)
    assert (found["right"], found["missed"], found["false"]) == (True, [], [])
    assert [p["covered"] for p in found["parameters"]] == [True]
    assert score(truth("null"), said)["right"]
    unsure = answer(minor=("gravity",), verdict="no_gap", gravity={**gravity, "verdict": "candidate"})
    assert not score(truth("effect", gravity={"g_ms2": 9.79}), unsure)["right"]


def test_a_value_outside_its_interval_is_not_covered() -> None:
    found = score(FRICTION, answer("friction", friction={"parameters": {"mu": (0.31, 0.32, 0.33)}}))
    assert [p["covered"] for p in found["parameters"]] == [False]


def test_nulls_and_forces_outside_the_library_must_get_no_name() -> None:
    assert score(truth("null"), answer(verdict="no_gap"))["right"]
    assert score(truth("null"), answer("gravity"))["false"] == ["gravity"]
    assert score(truth("outside", cubic_drag={}), answer(verdict="unexplained"))["right"]
    named = score(truth("outside", cubic_drag={}), answer("linear_drag"))
    assert not named["right"]
    assert named["false"] == ["linear_drag"]


def test_both_of_a_pair_must_be_named() -> None:
    both = truth("pair", friction={"mu": 0.3}, gravity={"g_ms2": 9.0})
    assert score(both, answer("gravity", "friction"))["right"]
    assert score(both, answer("gravity", "cohesion", cohesion={"classes": ("friction",)}, friction={}))["right"]
    assert score(both, answer("gravity"))["missed"] == ["friction"]


def test_of_several_at_once_three_quarters_must_be_named_and_nothing_else() -> None:
    four = truth("four", friction={"mu": 0.3}, gravity={"g_ms2": 9.0}, magnus={}, inertia={"scale_rel": 1.2})
    assert score(four, answer("gravity", "friction", "magnus"))["right"]
    assert not score(four, answer("gravity", "friction"))["right"]
    assert not score(four, answer("gravity", "friction", "magnus", "vortex"))["right"]


def test_without_its_effect_a_gap_must_not_be_called_explained() -> None:
    assert score(truth("without", restitution={"e": 0.3}), answer(verdict="unexplained"))["right"]
    assert not score(truth("without", restitution={"e": 0.3}), answer("compliance"))["right"]


def test_an_error_that_nobody_would_notice_has_no_share() -> None:
    assert score(FRICTION, answer("friction", friction={}, error=(0.4, 0.1)))["error_closed"] is None
    assert score(FRICTION, answer(error=(None, None)))["error_closed"] is None
    assert score(FRICTION, answer(error=(4.0, 5.0)))["error_closed"] == pytest.approx(-0.25)


def test_the_summary_counts() -> None:
    found = summarise(
        [
            score(FRICTION, answer("friction", friction={"parameters": {"mu": (0, 1, 2)}})),
            score(FRICTION, answer("magnus", error=(4.0, 3.0))),
            score(truth("null"), answer("gravity")),
            score(truth("null"), answer(candidates=("gravity",), verdict="no_gap")),
            score(truth("outside", cubic_drag={}), answer(verdict="unexplained")),
        ]
    )
    assert list(found) == list(MEASURES)
    assert found["right_name"] == {"count": 1, "of": 2, "share": 0.5, "wanted": "at least 95 %"}
    assert found["false_names_on_nulls"]["count"] == 1
    assert found["candidates_on_nulls"]["count"] == 2
    assert found["further_false_names"]["count"] == 1
    assert found["coverage"]["share"] == 1.0
    assert found["error_closed"]["value"] == pytest.approx((0.95 + 0.25) / 2)
    assert found["outside_not_named"]["count"] == 1
    assert found["pairs_both_named"]["share"] is None
