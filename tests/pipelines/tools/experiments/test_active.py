"""The loop of chosen tosses ends when the name is certain, and makes the tosses that it says."""

from __future__ import annotations

import numpy as np
import pytest

from pipelines.tools.experiments.active import FIRST, RIVALRIES, Rivalry, ordinary, run_case, simulated, table
from tossid.objects import load_object
from tossid.physics.effects import effect_named


def test_every_rivalry_is_of_the_library_and_no_rival_contains_the_effect() -> None:
    for case in RIVALRIES:
        effect = effect_named(case.effect)
        assert set(case.values) == {parameter.name for parameter in effect.parameters}
        assert not any(case.effect in effect_named(rival).contains for rival in case.rivals)


def test_a_toss_begins_at_the_release_that_is_asked_for() -> None:
    model, case = load_object("cube"), RIVALRIES[0]
    usual = ordinary(1, case, model, np.random.default_rng(0))[0]
    again = simulated(usual.q[:1], usual.v[:1], case, model, np.random.default_rng(1))[0]
    assert np.linalg.norm(again.q[0, :3] - usual.q[0, :3]) < 2e-3
    assert len(again) > 20


def test_a_case_ends_when_no_rival_is_left() -> None:
    """Friction of 0.35 for 0.18 and a pull that is none of it: six tosses, the fewest by which a rival can be left."""
    case = Rivalry("friction", {"mu": 0.35}, ("adhesion",))
    made = run_case(case, 0, ("chosen", 0), most=8, seed=0)
    assert made["tosses"] == 6
    assert made["left"] == [1, 1, 0]
    assert made["lead"][-1] > made["lead"][0] > 0
    assert len(made["expected_sd"]) == len(made["left"]) - 1
    assert min(made["expected_sd"]) > 3


def test_the_table_has_tosses_and_what_each_brought() -> None:
    line = {"case": 0, "effect": "friction", "rivals": ["cohesion"], "most": 8, "draw": 0}
    ended = {**line, "way": "chosen", "tosses": 6, "left": [1, 1, 0], "lead": [1.0, 4.0, 9.0]}
    open_ = {**line, "way": "random", "tosses": None, "left": [1] * 5, "lead": [0.0, 0.0, 0.0, 0.0, 2.0]}
    assert FIRST == 4
    assert table([ended, open_]).splitlines()[-1] == "| friction | cohesion | 6 (4.0) | over 8 (0.5) |  |"


@pytest.mark.slow
def test_gravity_and_a_clock_cannot_be_told_apart_by_any_toss() -> None:
    made = run_case(RIVALRIES[-1], 9, ("chosen", 0), most=7, seed=0)
    assert made["tosses"] is None
    assert made["left"] == [1] * 4
