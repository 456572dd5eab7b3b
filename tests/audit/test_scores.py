"""Answers made by hand are scored as they should be; ranks of true values are probabilities; tables say the same."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.stats import t as student

from tests.audit.answers import answer, truth
from tossid.audit.figures import detection
from tossid.audit.ranks import rank, uniform_p, within
from tossid.audit.result import Audit
from tossid.audit.scores import MEASURES, score, summarise

FRICTION = truth("effect", friction={"mu": 0.3})


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


GRAVITY = truth("effect", gravity={"g_ms2": 9.79})
PAIR = truth("pair", friction={"mu": 0.3}, gravity={"g_ms2": 9.0})
FOUR = truth("four", friction={"mu": 0.3}, gravity={"g_ms2": 9.0}, magnus={}, inertia={"scale_rel": 1.2})
OUTSIDE = truth("outside", cubic_drag={})
WITHOUT = truth("without", restitution={"e": 0.3})
ALIKE = {"classes": ("friction",)}
SMALL = {"classes": ("length_scale",), "parameters": {"g_ms2": (9.7, 9.8, 9.9)}}


def minor(**gravity: Any) -> dict[str, Any]:
    return answer(minor=("gravity",), verdict="no_gap", gravity={**SMALL, **gravity})


@pytest.mark.parametrize(
    ("true", "said", "expected"),
    [
        # the right name first, with its value
        (
            FRICTION, answer("friction", friction={"parameters": {"mu": (0.29, 0.31, 0.33)}}),
            {"right": True, "false": [], "missed": [], "error_closed": pytest.approx(0.95), "phase_right": True},
        ),
        # a class of three counts, and one of four does not
        (FRICTION, answer("cohesion", cohesion={"classes": ("friction", "adhesion")}, friction={}), {"right": True}),
        (
            FRICTION, answer("cohesion", cohesion={"classes": ("adhesion", "restitution", "friction")}),
            {"right": False, "missed": ["friction"]},
        ),
        # the right name second is wrong, and the first is false
        (FRICTION, answer("magnus", "friction"), {"right": False, "false": ["magnus"]}),
        # a candidate is no name
        (
            FRICTION, answer(candidates=("friction",)),
            {"right": False, "right_or_candidate": True, "candidates": {"friction": ["friction"]}},
        ),
        (FRICTION, answer(candidates=("cohesion",), cohesion=ALIKE), {"right_or_candidate": True}),
        (FRICTION, answer("magnus", candidates=("wind",)), {"right_or_candidate": False}),
        # a right name that is too small to matter counts, unless it is not sure
        (GRAVITY, minor(), {"right": True, "missed": [], "false": []}),
        (truth("null"), minor(), {"right": True}),
        (GRAVITY, minor(verdict="candidate"), {"right": False}),
        # nulls and forces outside the library must get no name
        (truth("null"), answer(verdict="no_gap"), {"right": True}),
        (truth("null"), answer("gravity"), {"false": ["gravity"]}),
        (OUTSIDE, answer(verdict="unexplained"), {"right": True}),
        (OUTSIDE, answer("linear_drag"), {"right": False, "false": ["linear_drag"]}),
        # both of a pair, and three quarters of several, and nothing else
        (PAIR, answer("gravity", "friction"), {"right": True}),
        (PAIR, answer("gravity", "cohesion", cohesion=ALIKE, friction={}), {"right": True}),
        (PAIR, answer("gravity"), {"missed": ["friction"]}),
        (FOUR, answer("gravity", "friction", "magnus"), {"right": True}),
        (FOUR, answer("gravity", "friction"), {"right": False}),
        (FOUR, answer("gravity", "friction", "magnus", "vortex"), {"right": False}),
        # without its effect a gap must not be called explained
        (WITHOUT, answer(verdict="unexplained"), {"right": True}),
        (WITHOUT, answer("compliance"), {"right": False}),
        # an error that nobody would notice has no share
        (FRICTION, answer("friction", friction={}, error=(0.4, 0.1)), {"error_closed": None}),
        (FRICTION, answer(error=(None, None)), {"error_closed": None}),
        (FRICTION, answer(error=(4.0, 5.0)), {"error_closed": pytest.approx(-0.25)}),
    ],
)  # fmt: skip
def test_answers_are_scored(true: dict[str, Any], said: dict[str, Any], expected: dict[str, Any]) -> None:
    found = score(true, said)
    assert {key: found[key] for key in expected} == expected


def test_a_value_outside_its_interval_is_not_covered() -> None:
    for high, covered in ((0.33, True), (0.29, False)):
        interval = {"parameters": {"mu": (0.28, 0.285, high)}}
        (found,) = score(FRICTION, answer("friction", friction=interval))["parameters"]
        assert found["covered"] == covered
        assert (0.025 < found["rank"] < 0.975) == covered


# ---------------------------------------------------------------- ranks


def test_ends_of_a_95_percent_interval_have_the_ranks_of_its_quantiles() -> None:
    stated = {"value": 2.0, "ci95": [1.0, 3.0]}
    for true, expected in ((1.0, 0.025), (2.0, 0.5), (3.0, 0.975)):
        assert rank(true, stated, 12.0) == pytest.approx(expected)
    # an end that was drawn in is as far away as the other; without an interval there is no rank
    assert rank(0.3, {"value": 0.1, "ci95": [0.0, 0.3]}, 20.0) == pytest.approx(0.975)
    for nothing in ([None, None], [1.0, 1.0]):
        assert rank(1.0, {"value": 1.0, "ci95": nothing}, 9.0) is None


def test_right_intervals_have_uniform_ranks_and_narrow_ones_do_not() -> None:
    rng, freedom, half = np.random.default_rng(1), 15.0, student.ppf(0.975, 15.0)
    errors = rng.standard_t(freedom, 300)
    ranks = {
        width: [rank(0.0, {"value": e, "ci95": [e - width * half, e + width * half]}, freedom) or 0.0 for e in errors]
        for width in (1.0, 0.5)
    }
    assert np.mean(within(ranks[1.0], 0.5)) == pytest.approx(0.5, abs=0.08)
    assert np.mean(within(ranks[1.0], 0.9)) == pytest.approx(0.9, abs=0.05)
    right, narrow = (uniform_p([[each] for each in ranks[width]]) for width in (1.0, 0.5))
    assert right is not None
    assert narrow is not None
    assert right > 0.05
    assert narrow < 1e-6
    assert uniform_p([[], []]) is None


# ---------------------------------------------------------------- tables, figures and files


CASES = {
    "right": {
        "truth": FRICTION,
        "gap": answer("friction", minor=("wind",), friction={"parameters": {"mu": (0.29, 0.31, 0.33)}}),
    },
    "wrong": {"truth": FRICTION, "gap": answer("gravity", candidates=("friction",))},
    "null": {"truth": truth("null"), "gap": answer(verdict="no_gap", error=(None, None))},
}


def made() -> Audit:
    return Audit.of({name: {**case, "seconds": 2.0} for name, case in CASES.items()}, {"003-x": "it diverged"})


def test_rows_hold_what_was_there_and_what_was_named() -> None:
    right, wrong, null = made().case_table()
    named = "friction, wind (too small to matter)"
    assert right == ["right", "effect", "lcp", "friction mu=0.3", "40", named, "explained", "yes"]
    assert wrong[5:] == ["gravity", "explained", "NO"]
    assert null[3:] == ["nothing", "", "nothing", "no_gap", "yes"]


def test_tables_say_how_many_were_right() -> None:
    table = {words: rest for words, *rest in made().measure_table()}
    assert table[MEASURES["right_name"][0]] == ["1 of 2 (50 %)", "at least 95 %"]
    assert MEASURES["four_right"][0] not in table  # no such case
    *_, right, wrong, null = made().markdown().splitlines()
    assert right.endswith("| yes |  | 1 of 1 | 8.00, 0.40 |")
    assert wrong.endswith("| NO | friction |  | 8.00, 0.40 |")
    assert null.endswith("| yes |  |  |  |")
    assert "audit of 3 cases, 1 failed" in repr(made())
    assert "1 of 2" in made()._repr_html_()


def test_files_hold_the_rows(tmp_path: Path) -> None:
    paths = made().save(tmp_path)
    assert [path.name for path in paths] == ["detection.png"]
    assert all(path.read_bytes().startswith(b"\x89PNG") for path in paths)
    content = json.loads((tmp_path / "audit.json").read_text())
    assert content["summary"] == made().summary
    assert content["failed"] == {"003-x": "it diverged"}
    assert [row["right"] for row in content["cases"]] == [True, False, True]
    assert (tmp_path / "table.md").read_text() == made().markdown()


def test_each_case_stands_at_its_least_displacement() -> None:
    right = {"engine": "lcp", "displacement": [20.0], "right": True}
    wrong = {"engine": "mujoco", "displacement": [200.0, 3.0], "right": False}
    points = [line.get_xydata() for line in detection([right, wrong]).axes[0].get_lines()]
    single = [xy[0].tolist() for xy in points if len(xy) == 1]
    assert [(x, round(y)) for x, y in single] == [(20.0, 1), (3.0, 0)]
