"""Answers made by hand are scored as they should be."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from tossid.diagnosis.audit.scores import calibration, claims, score, summarise


def truth(kind: str, **effects: dict[str, float]) -> dict[str, Any]:
    return {"case": {"kind": kind, "seed": 0}, "effects": effects}


def answer(*named: str, verdict: str = "explained", closed: float = 0.95, **found: Any) -> dict[str, Any]:
    """gap.json as far as it is scored. found: NAME={"classes": (…), "parameters": {KEY: (low, value, high)}}."""
    findings = []
    for name in dict.fromkeys([*named, *found]):
        about = found.get(name, {})
        parameters = {k: {"value": v, "ci95": [lo, hi]} for k, (lo, v, hi) in about.get("parameters", {}).items()}
        related = [[float(i == k) for k in range(len(parameters))] for i in range(len(parameters))]
        findings.append(
            {
                "name": name,
                "confusable_with": list(about.get("classes", ())),
                "parameters": parameters,
                "correlation": related,
                "evidence": {"n_tosses": 20.0},
            }
        )
    where = [{"phase": "impact", "share": 0.5}] if verdict in ("unexplained", "partly_explained") else []
    return {
        "gap": {"by_phase": [{"phase": "flight", "share": 0.2}, {"phase": "impact", "share": 0.8}]},
        "effects": findings,
        "explanation": {
            "verdict": verdict,
            "effects": list(named),
            "gap_closed": {"value": closed},
            "unexplained_where": where,
        },
    }


def test_the_right_name_first() -> None:
    friction = {"parameters": {"mu": (0.29, 0.31, 0.33)}}
    found = score(truth("effect", friction={"mu": 0.3}), answer("friction", friction=friction), closable=0.96)
    assert found["right"]
    assert found["false"] == []
    assert [p["covered"] for p in found["parameters"]] == [True]
    assert [p["led"] for p in found["parameters"]] == [True]
    assert 0.025 < found["parameters"][0]["rank"] < 0.5
    assert len(found["joint_ranks"]) == 1
    assert found["closed"] == pytest.approx(0.95 / 0.96)
    assert found["phase_right"]


def test_a_class_of_three_counts_and_one_of_four_does_not() -> None:
    three = answer("cohesion", cohesion={"classes": ("friction", "adhesion")})
    assert score(truth("effect", friction={"mu": 0.3}), three)["right"]
    four = answer("cohesion", cohesion={"classes": ("adhesion", "restitution", "friction")})
    found = score(truth("effect", friction={"mu": 0.3}), four)
    assert not found["right"]
    assert found["missed"] == ["friction"]


def test_the_right_name_second_is_wrong_and_the_first_is_false() -> None:
    found = score(truth("effect", friction={"mu": 0.3}), answer("magnus", "friction"))
    assert not found["right"]
    assert found["false"] == ["magnus"]


def test_a_value_outside_its_interval_is_not_covered() -> None:
    friction = {"parameters": {"mu": (0.31, 0.32, 0.33)}}
    found = score(truth("effect", friction={"mu": 0.3}), answer("friction", friction=friction))
    assert [p["covered"] for p in found["parameters"]] == [False]


def test_nulls_and_forces_outside_the_library_must_get_no_name() -> None:
    assert score(truth("null"), answer(verdict="no_gap"))["right"]
    assert score(truth("null"), answer("gravity"))["false"] == ["gravity"]
    assert score(truth("outside", cubic_drag={}), answer(verdict="unexplained"))["right"]
    hedged = score(truth("outside", cubic_drag={}), answer("linear_drag", verdict="partly_explained"))
    assert not hedged["right"]
    assert hedged["hedged"]
    assert not score(truth("outside", cubic_drag={}), answer("linear_drag"))["hedged"]


def test_both_of_a_pair_must_be_named() -> None:
    both = truth("pair", friction={"mu": 0.3}, gravity={"g_ms2": 9.0})
    assert score(both, answer("gravity", "friction"))["right"]
    assert score(both, answer("gravity", "cohesion", cohesion={"classes": ("friction",)}))["right"]
    assert score(both, answer("gravity"))["missed"] == ["friction"]
    recording = truth("recording", length_scale={"scale_rel": 0.98}, world_tilt={"x_rad": 0.01, "y_rad": 0.0})
    assert score(recording, answer("world_tilt", "length_scale"))["right"]
    assert not score(recording, answer("world_tilt", "gravity"))["right"]


def test_of_several_at_once_three_quarters_must_be_named_and_nothing_else() -> None:
    four = truth("four", friction={"mu": 0.3}, gravity={"g_ms2": 9.0}, magnus={}, inertia={"scale_rel": 1.2})
    right = score(four, answer("gravity", "friction", "magnus"))
    assert right["right"]
    assert not score(four, answer("gravity", "friction"))["right"]
    assert not score(four, answer("gravity", "friction", "magnus", "vortex"))["right"]
    found = summarise([right])
    assert (found["four_found"]["count"], found["four_found"]["of"]) == (3, 4)
    assert found["four_right"]["share"] == 1.0
    assert "eight_found" not in found


def test_without_its_effect_a_gap_must_not_be_called_explained() -> None:
    found = score(truth("without", restitution={"e": 0.3}), answer(verdict="unexplained"))
    assert found["right"]
    assert found["phase_right"]
    assert not score(truth("without", restitution={"e": 0.3}), answer("compliance"))["right"]
    weak = score(truth("without", restitution={"e": 0.3}), answer(verdict="no_gap"))
    assert weak["right"]
    assert weak["phase_right"] is None


def test_a_spoilt_parameter_must_be_restored() -> None:
    near, far = ({"parameters": {"mu": (0.1, mu, 0.3)}} for mu in (0.171, 0.16))
    for entry, restored in ((near, True), (far, False)):
        (found,) = score(truth("spoilt", friction={"mu": 0.175}), answer("friction", friction=entry))["parameters"]
        assert found["covered"]
        assert found["restored"] is restored


def test_the_summary_counts() -> None:
    scores = [
        score(truth("effect", friction={"mu": 0.3}), answer("friction", friction={"parameters": {"mu": (0, 1, 2)}})),
        score(truth("effect", friction={"mu": 0.3}), answer("magnus")),
        score(truth("null"), answer("gravity")),
        score(truth("null"), answer(verdict="no_gap")),
        score(truth("outside", cubic_drag={}), answer(verdict="unexplained")),
    ]
    found = summarise(scores)
    assert found["right_name"] == {"count": 1, "of": 2, "share": 0.5, "wanted": 0.9}
    assert found["false_names_on_nulls"] == {"count": 1, "of": 2}
    assert found["coverage"]["share"] == 1.0
    assert found["closed_median"]["value"] == pytest.approx(0.95)
    assert found["outside_not_named"]["count"] == 1
    assert found["pairs_both_named"]["share"] is None


def stated(*named: str, none: float | None, **found: Any) -> dict[str, Any]:
    """An answer whose effects have frequencies: NAME={"classes": (...), "frequency": ...}."""
    gap = answer(*named, **found)
    for finding in gap["effects"]:
        finding["frequency"] = found.get(finding["name"], {}).get("frequency", 0.0)
    gap["explanation"] |= {"probability_none": none, "candidates": []}
    return gap


def test_a_class_is_claimed_with_the_sum_of_its_frequencies() -> None:
    gap = stated(
        "gravity",
        none=0.1,
        gravity={"classes": ("time_base",), "frequency": 0.6},
        time_base={"classes": ("gravity",), "frequency": 0.3},
    )
    assert claims(gap, "effect", {"time_base"}) == [
        {"of": "gravity", "probability": pytest.approx(0.9), "true": True},
        {"of": "none", "probability": 0.1, "true": False},
    ]
    assert [claim["true"] for claim in claims(gap, "null", set())] == [False, True]
    assert [claim["of"] for claim in claims(gap, "spoilt", {"gravity"})] == ["gravity"]


def test_without_repeats_nothing_is_claimed() -> None:
    assert claims(stated("friction", none=None), "effect", {"friction"}) == []
    assert score(truth("effect", friction={"mu": 0.3}), answer("friction"))["claims"] == []


def test_proper_scores_are_best_for_the_truth() -> None:
    def of(p: float, *outcomes: bool) -> dict[str, Any]:
        return calibration([{"probability": p, "true": each} for each in outcomes])

    found = of(0.75, True, True, True, False)
    assert found["brier"] == pytest.approx((3 * 0.25**2 + 0.75**2) / 4)
    assert found["log"] == pytest.approx(-(3 * np.log(0.75) + np.log(0.25)) / 4)
    assert found["reliability"] == [{"probability": 0.75, "true": 0.75, "of": 4}]
    for other in (0.5, 0.9):
        assert of(other, True, True, True, False)["brier"] > found["brier"]
        assert of(other, True, True, True, False)["log"] > found["log"]
    # a certain answer that is wrong costs much, not everything
    assert of(1.0, False)["log"] == pytest.approx(-np.log(0.02))
    assert calibration([])["brier"] is None


def test_a_right_name_that_is_too_small_to_matter_counts_unless_it_is_not_sure() -> None:
    said = answer(verdict="no_gap", gravity={"classes": ("length_scale",), "parameters": {"g_ms2": (9.7, 9.8, 9.9)}})
    said["explanation"]["minor"] = ["gravity"]
    said["effects"][0]["verdict"] = "confusable"
    found = score(truth("effect", gravity={"g_ms2": 9.79}), said)
    assert found["right"]
    assert (found["named"], found["minor"], found["missed"], found["false"]) == ([], ["gravity"], [], [])
    assert [p["covered"] for p in found["parameters"]] == [True]
    assert score(truth("null"), said)["right"]
    said["effects"][0]["verdict"] = "candidate"
    assert not score(truth("effect", gravity={"g_ms2": 9.79}), said)["right"]
