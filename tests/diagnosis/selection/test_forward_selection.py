"""Rounds end, prefer one effect to two, and what they went through stays true when an effect takes another's place."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from tests.diagnosis.by_hand import EFFECTS, hypothesis
from tests.diagnosis.tossed import ONCE, seen
from tossid.diagnosis.likelihood.evidence import Hypothesis
from tossid.diagnosis.likelihood.fitting import Fitted
from tossid.diagnosis.selection.cross_validation import Candidate, CrossValidator
from tossid.diagnosis.selection.flight_search import search_flight
from tossid.diagnosis.selection.forward_selection import ForwardSelection, SelectionPath
from tossid.diagnosis.under_way import UnderWay
from tossid.objects import ObjectModel
from tossid.physics.effects import World
from tossid.settings.diagnosis.diagnose import DiagnoseSettings


def candidate(model: ObjectModel, **values: Any) -> Candidate:
    fitted = cast(Fitted, SimpleNamespace(hypothesis=hypothesis(model, **values)))
    return Candidate(None, fitted, np.zeros(1), np.zeros(1), np.zeros((1, 1)))


def test_a_replacement_has_the_replaced_effect_and_its_rivals_in_its_class(cube: ObjectModel) -> None:
    nothing = candidate(cube)
    before = candidate(cube, rounded_corners=[0.003], friction=[0.3])
    after = candidate(cube, inertia=[1.3], friction=[0.3])
    classes = {
        "rounded_corners": (EFFECTS["inertia"], EFFECTS["compliance"]),
        "friction": (EFFECTS["cohesion"],),
    }
    path = SelectionPath((nothing, before), {}, classes, (), {}).ending_in(after)
    assert path.history == (nothing, after)
    assert path.classes == {
        "inertia": (EFFECTS["rounded_corners"], EFFECTS["compliance"]),
        "friction": (EFFECTS["cohesion"],),
    }
    # and back: nothing of the class is lost on the way
    back = path.ending_in(before)
    assert {each.name for each in back.classes["rounded_corners"]} == {"inertia", "compliance"}


def test_the_same_effects_at_other_values_have_the_same_classes(cube: ObjectModel) -> None:
    before, after = candidate(cube, friction=[0.3]), candidate(cube, friction=[0.25])
    path = SelectionPath((before,), {}, {"friction": (EFFECTS["cohesion"],)}, (), {})
    assert path.ending_in(after).classes == path.classes


VALUES = {"gravity": [9.83], "world_tilt": [0.0, -0.002], "uniform_force": [0.0, -0.009, -0.008]}


class ByHand(ForwardSelection):
    """Rounds whose hypotheses gain what a table says, over the one without effects."""

    def __init__(
        self, model: ObjectModel, gains: Mapping[str, float], pruned: Mapping[str, Sequence[str]] | None = None
    ) -> None:
        self.model, self.gains, self.leaves = model, gains, pruned or {}
        self.library, self.under_way = [EFFECTS[name] for name in VALUES], UnderWay()
        self.settings, self.level, self.can_name = DiagnoseSettings().selection, 0.003, True
        self.validator = cast(
            CrossValidator,
            SimpleNamespace(
                p_value_over=lambda one, other: 0.001 if self.of(one) > self.of(other) + 10 else 0.1,
                gain_over=lambda one, other: np.array([self.of(one) - self.of(other)]),
                by_toss=lambda gain: gain,
            ),
        )

    def of(self, one: Candidate) -> float:
        return self.gains.get("+".join(sorted(one.hypothesis.names)), 0.0)

    def made(self, names: Sequence[str], last: str | None = None) -> Candidate:
        made = candidate(self.model, **{name: VALUES[name] for name in names})
        gain = np.array([self.gains.get("+".join(sorted(names)), 0.0)])
        # a gain is over the hypothesis before, but only its order counts here
        made = Candidate(EFFECTS[last] if last else None, made.fitted, gain, gain, np.full((1, 1), 1.0))
        cast(Any, made.fitted).evidence = SimpleNamespace(
            windows=SimpleNamespace(
                weights=np.ones(1), settings=SimpleNamespace(windows=SimpleNamespace(flight_weight=1))
            )
        )
        return made

    def round(
        self, first: Candidate, present: Candidate, least_gain: float = 0.0, share: float = 0.0
    ) -> list[Candidate]:
        names = present.hypothesis.names
        return [self.made([*names, name], name) for name in VALUES if name not in names]

    def is_significant(self, first: Candidate, present: Candidate, each: Candidate) -> bool:
        return self.of(each) > self.of(present) + 5

    def refitted(self, present: Candidate, rounds: int = 1) -> Candidate:
        return present

    def pruned(
        self,
        first: Candidate,
        present: Candidate,
        known: Mapping[str, Candidate] | None = None,
        *,
        thorough: bool = True,
    ) -> tuple[Candidate, dict[str, Candidate]]:
        names = "+".join(sorted(present.hypothesis.names))
        return (self.made(self.leaves[names]) if names in self.leaves else present), {}


def test_a_general_effect_is_better_than_its_special_case_with_another(cube: ObjectModel) -> None:
    gains = {"gravity": 35.0, "uniform_force": 43.0, "world_tilt": 25.0, "gravity+world_tilt": 46.0}
    rounds = ByHand(cube, gains)
    first = rounds.made([])
    path = rounds.run(first, [first])
    assert [each.hypothesis.names for each in path.history] == [(), ("uniform_force",)]
    assert {effect.name for effect in path.classes["uniform_force"]} == {"gravity", "world_tilt"}
    # but not where both together are clearly better
    both = ByHand(cube, {**gains, "gravity+world_tilt": 90.0})
    assert set(both.run(first, [first]).history[-1].hypothesis.names) == {"gravity", "world_tilt"}


def test_rounds_that_come_back_end_at_the_best_of_them(cube: ObjectModel) -> None:
    gains = {"gravity": 20.0, "world_tilt": 19.0, "gravity+world_tilt": 40.0}
    rounds = ByHand(cube, gains, {"gravity+world_tilt": ()})
    first = rounds.made([])
    path = rounds.run(first, [first])
    assert [each.hypothesis.names for each in path.history] == [(), ("gravity",), (), ("gravity",)]


@pytest.mark.parametrize("seed", [3, 5])
def test_a_weak_force_is_one_effect_and_does_not_come_and_go(cube: ObjectModel, seed: int) -> None:
    """A force of 3 per mille of the weight, across and up: gravity or a tilt explain a part of it each."""
    force = np.array([0.0, -0.0086, -0.0077])
    tosses = seen(EFFECTS["uniform_force"].at(World(cube), force), cube, 20, seed=seed)
    validator = CrossValidator.of(tosses, cube, seed=0, settings=ONCE)
    library = [EFFECTS[name] for name in ("gravity", "world_tilt", "uniform_force", "position_force")]
    found = search_flight(validator, library, Hypothesis(World(cube)))
    assert found is not None
    assert found.present.hypothesis.names == ("uniform_force",)
    assert len(found.history) <= 3
    np.testing.assert_allclose(found.present.hypothesis.values_of("uniform_force"), force, atol=0.004)
