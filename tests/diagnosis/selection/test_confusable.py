"""What could stand in for an effect: what does as well, and what contains it if it is a little better."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.diagnosis.by_hand import EFFECTS
from tests.diagnosis.tossed import ONCE, seen
from tossid.diagnosis.likelihood.evidence import Hypothesis
from tossid.diagnosis.selection.confusable import ConfusableClasses
from tossid.diagnosis.selection.cross_validation import CrossValidator
from tossid.diagnosis.selection.forward_selection import ForwardSelection, SelectionPath
from tossid.diagnosis.selection.screening import screen
from tossid.diagnosis.under_way import UnderWay
from tossid.objects import ObjectModel
from tossid.physics.effects import World

LIBRARY = [EFFECTS[name] for name in ("gravity", "time_base", "linear_drag", "uniform_force", "position_force")]


def in_flight(cube: ObjectModel, name: str, values: list[float]) -> tuple[ForwardSelection, SelectionPath]:
    """Rounds on the flights of sixteen tosses with an effect, and how they went."""
    tosses = seen(EFFECTS[name].at(World(cube), np.array(values)), cube, 16, seed=4)
    validator = CrossValidator.of(tosses, cube, seed=0, settings=ONCE)
    validator = replace(validator, windows=validator.windows.rows(np.flatnonzero(validator.windows.free)))
    rounds = ForwardSelection(validator, LIBRARY, UnderWay())
    first = validator.evaluate(Hypothesis(World(cube)))
    return rounds, rounds.run(first, [first])


def test_flight_cannot_distinguish_gravity_from_the_clock(cube: ObjectModel) -> None:
    rounds, path = in_flight(cube, "gravity", [9.7])
    needed, classes = ConfusableClasses(rounds).of(path.history[-1], path.without, path)
    (name,) = needed
    assert {name, *(each.name for each in classes[name])} >= {"gravity", "time_base"}
    assert "linear_drag" not in {each.name for each in classes[name]}
    assert needed[name].p_value < rounds.level


@pytest.mark.parametrize("place", [[0.1, -0.2, 0.3]])
def test_a_weak_spring_is_no_less_than_in_the_class_of_a_force(cube: ObjectModel, place: list[float]) -> None:
    rounds, path = in_flight(cube, "position_force", [0.05, *place])
    present = path.history[-1]
    _, classes = ConfusableClasses(rounds).of(present, path.without, path)
    (name,) = present.hypothesis.names
    assert "position_force" in {name, *(each.name for each in classes[name])}


def test_a_spring_leads_although_a_whole_step_from_its_starts_goes_too_far(cube: ObjectModel) -> None:
    """Force is strength times place: from a third of the strength, a step to the force triples it once more."""
    rounds, path = in_flight(cube, "position_force", [0.156, 0.25, 0.1, 0.54])
    assert path.history[-1].hypothesis.names == ("position_force",)
    screened = screen(rounds.validator, path.history[0], EFFECTS["position_force"])
    assert screened.from_start
    assert screened.gain > 50


def test_what_contains_an_effect_has_to_be_clearly_better_than_it(cube: ObjectModel) -> None:
    rounds, path = in_flight(cube, "gravity", [9.7])
    compare, here = ConfusableClasses(rounds), path.history[-1]
    nothing = path.history[0]
    assert compare.is_better_instead(here, nothing, EFFECTS["uniform_force"], "gravity")
    assert not compare.is_better_instead(nothing, here, EFFECTS["uniform_force"], "gravity")
    assert not compare.is_better_instead(here, here, EFFECTS["time_base"], "gravity")


def test_a_hypothesis_with_one_effect_more_has_to_be_clearly_better(cube: ObjectModel) -> None:
    """Twelve of sixteen tosses gain: enough for another effect in the place of one, and not for one more."""
    rounds, path = in_flight(cube, "gravity", [9.7])
    compare, nothing, own = ConfusableClasses(rounds), path.history[0], path.history[-1]
    toss = rounds.validator.windows.toss
    by_toss = np.where((toss >= 4) & (toss < 8), -1.0, 1.0) * (1.0 + toss) / np.bincount(toss)[toss]
    better = replace(own, log_likelihood=nothing.log_likelihood + 0.1 * by_toss)
    p_value = rounds.validator.p_value_over(better, nothing)
    assert rounds.level < p_value < rounds.settings.class_level
    assert not compare.is_better_instead(better, nothing, EFFECTS["time_base"], "linear_drag")
    instead = replace(nothing, fitted=replace(nothing.fitted, hypothesis=Hypothesis(World(cube)).plus(EFFECTS["wind"])))
    assert compare.is_better_instead(better, instead, EFFECTS["time_base"], "linear_drag")
