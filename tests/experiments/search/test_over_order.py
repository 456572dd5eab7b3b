"""Cases whose effects change over the order: their values, and the scores of answers made by hand."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Any

import numpy as np

from experiments.search.over_order import CONSTANT, DRIFT, NONE, SHUFFLED, STEP, drawn, scored, tosses_over_order
from tossid.objects import ObjectModel, corner_positions
from tossid.settings.audit import AuditSettings
from tossid.settings.synthesis import SynthesizeSettings


def answer(*changing: dict[str, Any], left: tuple[str, ...] = ()) -> dict[str, Any]:
    """gap.json as far as it is scored."""
    findings = [{"over_order": {"p_value": 0.001}, **each} for each in changing]
    return {"effects": [{"name": "gravity"}, *findings], "changes_left": [{"before": name} for name in left]}


def steps(name: str, *starts: str, parameters: Mapping[str, Any] = MappingProxyType({})) -> dict[str, Any]:
    return {"name": name, "sessions": [{"first": start, "last": "", "parameters": parameters} for start in starts]}


TILT = {"world_tilt": {"x_rad": 0.01}}


def test_only_tosses_from_the_change_on_have_the_effect(cube: ObjectModel) -> None:
    settings = SynthesizeSettings(tosses=5, seconds=0.8)
    effects = {"ground_height": {"z_m": 0.02}}
    for shares in ([0.0, 0, 0, 1, 1], [0.0, 0.25, 0.5, 0.75, 1]):
        made = tosses_over_order(effects, np.array(shares), cube, settings, np.random.default_rng(2))
        assert [int(toss.name) for toss in made] == [0, 1, 2, 3, 4]
        lowest = [corner_positions(cube, toss.q)[..., 2].min() for toss in made]
        np.testing.assert_allclose(lowest, 0.02 * np.array(shares), atol=2e-3)


def test_the_same_cases_are_drawn_whatever_their_number() -> None:
    cases = drawn(15, 4, AuditSettings(seed=2))
    assert cases[:3] == drawn(3, 0, AuditSettings(seed=2))
    assert [case["form"] for case in cases] == [STEP] * 5 + [DRIFT] * 2 + [STEP] * 5 + [DRIFT] * 2 + [STEP] + [
        NONE, CONSTANT, NONE, CONSTANT,
    ]  # fmt: skip
    assert all(8 <= case["at"] <= 32 for case in cases if case["form"] == STEP)
    assert {case["engine"] for case in cases} == {"lcp", "mujoco"}


def test_answers_are_scored_by_name_and_moment() -> None:
    case = {"form": STEP, "at": 20}
    after = {"x_rad": {"value": 0.011, "ci95": [0.009, 0.013]}}
    right = scored(case, TILT, answer(steps("world_tilt", "00", "22", parameters=after)))
    assert (right["right"], right["moment_right"], right["changing"]) == (True, True, {"world_tilt": STEP})
    assert right["held"] == {"world_tilt.x_rad": True}
    late = scored(case, TILT, answer(steps("world_tilt", "00", "24")))
    assert (late["right"], late["moment_right"]) == (True, False)
    other = scored(case, TILT, answer(steps("friction", "00", "20")))
    assert (other["right"], other["moment_right"], other["further"]) == (False, True, ["friction"])
    more = scored(case, TILT, answer(steps("world_tilt", "00", "20"), steps("wind", "00", "9")))
    assert (more["right"], more["further"]) == (True, ["wind"])
    nameless = scored(case, TILT, answer(left=("19",)))
    assert (nameless["right"], nameless["moment_right"]) == (False, True)


def test_of_nothing_nothing_is_right_and_a_drift_is_one() -> None:
    assert scored({"form": NONE, "at": 0}, {}, answer())["right"]
    for form in (NONE, CONSTANT, SHUFFLED):
        assert not scored({"form": form, "at": 0}, TILT, answer(left=("5",)))["right"]
    drift = {"name": "friction", "drift": {"per_toss": {}, "ends": []}}
    found = scored({"form": DRIFT, "at": 0}, {"friction": {"mu": 0.26}}, answer(drift))
    assert (found["right"], found["changing"]) == (True, {"friction": DRIFT})
