"""Cases whose effects change over the order: their values, and the scores of answers made by hand."""

from __future__ import annotations

from typing import Any

import numpy as np

from experiments.search.order_cases import (
    CONSTANT,
    DRIFT,
    NONE,
    SHUFFLED,
    STEP,
    OrderOfCase,
    score_over_order,
    tosses_over_order,
)
from tossid.objects import ObjectModel, corner_positions
from tossid.settings.synthesis import SynthesizeSettings


def answer(*changing: dict[str, Any], left: tuple[str, ...] = ()) -> dict[str, Any]:
    """gap.json as far as it is scored."""
    findings = [{"over_order": {"p_value": 0.001}, **each} for each in changing]
    return {"effects": [{"name": "gravity"}, *findings], "changes_left": [{"before": name} for name in left]}


def steps(name: str, *starts: str) -> dict[str, Any]:
    return {"name": name, "sessions": [{"first": start, "last": "", "parameters": {}} for start in starts]}


def truth(form: str, at: int = 0, **effects: dict[str, float]) -> dict[str, Any]:
    return {"order": {"form": form, "at": at}, "effects": effects, "rates": {"friction": {"mu": 0.002}}}


def test_only_tosses_from_the_change_on_have_the_effect(cube: ObjectModel) -> None:
    settings = SynthesizeSettings(tosses=5, seconds=0.8)
    effects = {"ground_height": {"z_m": 0.02}}
    lowest = []
    for order in (OrderOfCase(STEP, 3), OrderOfCase(DRIFT)):
        made = tosses_over_order(effects, order, cube, settings, np.random.default_rng(2))
        assert [toss.name for toss in made] == ["0", "1", "2", "3", "4"]
        lowest.append([corner_positions(cube, toss.q)[..., 2].min() for toss in made])
    np.testing.assert_allclose(lowest[0], [0, 0, 0, 0.02, 0.02], atol=2e-3)
    np.testing.assert_allclose(lowest[1], [0, 0.005, 0.01, 0.015, 0.02], atol=2e-3)


def test_answers_are_scored_by_name_and_moment() -> None:
    tilt = {"world_tilt": {"x_rad": 0.01}}
    right = score_over_order(truth(STEP, 20, **tilt), answer(steps("world_tilt", "00", "22")))
    assert (right["right"], right["moment_right"], right["form_right"]) == (True, True, True)
    late = score_over_order(truth(STEP, 20, **tilt), answer(steps("world_tilt", "00", "24")))
    assert (late["right"], late["moment_right"]) == (True, False)
    other = score_over_order(truth(STEP, 20, **tilt), answer(steps("friction", "00", "20")))
    assert (other["right"], other["moment_right"], other["further"]) == (False, True, ["friction"])
    more = score_over_order(truth(STEP, 20, **tilt), answer(steps("world_tilt", "00", "20"), steps("wind", "00", "9")))
    assert (more["right"], more["further"]) == (True, ["wind"])
    nameless = score_over_order(truth(STEP, 20, **tilt), answer(left=("19",)))
    assert (nameless["right"], nameless["moment_right"]) == (False, True)


def test_of_nothing_nothing_is_right_and_a_drift_has_its_rate() -> None:
    assert score_over_order(truth(NONE), answer())["right"]
    for form in (NONE, CONSTANT, SHUFFLED):
        assert not score_over_order(truth(form), answer(left=("5",)))["right"]
    drift = {
        "name": "friction",
        "drift": {"per_toss": {"mu": {"value": 0.0022, "ci95": [0.0018, 0.0026]}}, "ends": []},
    }
    found = score_over_order(truth(DRIFT, friction={"mu": 0.26}), answer(drift))
    assert found["right"]
    assert found["form_right"]
    assert found["rate"]["true"] == 0.002
