"""Hypotheses are fitted from what is given, and the true one is better than another."""

from __future__ import annotations

from pipelines.tools.experiments.by_hand.hypotheses import HEADS, hypothesis_with, rows
from tests.diagnosis.tossed import seen
from tossid.diagnosis.inference.hypothesis import Hypothesis
from tossid.diagnosis.problem import Problem
from tossid.objects import ObjectModel
from tossid.physics.effects import World


def test_the_true_effect_is_better_than_none(cube: ObjectModel) -> None:
    tosses = seen(World(cube.with_changes(friction=0.3)), cube, 20, seed=4, frames=60)
    problem = Problem(tosses[:12], Hypothesis(World(cube)), unseen=tosses[12:])
    nothing, friction = rows(problem, [{}, {"friction": {"mu": 0.25}}])
    assert nothing.count("|") == friction.count("|") == len(HEADS) + 1
    assert "friction: mu 0.3" in friction or "friction: mu 0.29" in friction
    gain, p_value, closed, error = (column.split(",")[0] for column in friction.split(" | ")[1:])
    assert float(gain) > 100
    assert float(p_value) < 0.01
    assert float(closed.split(" ")[0]) > 90
    assert float(error) < float(nothing.split(" | ")[4].split(",")[0])


def test_parameters_that_are_not_given_are_nominal(cube: ObjectModel) -> None:
    hypothesis = hypothesis_with(Hypothesis(World(cube)), {"ground_tilt": {"y_rad": 0.01}})
    assert hypothesis.values_of("ground_tilt").tolist() == [0.0, 0.01]
