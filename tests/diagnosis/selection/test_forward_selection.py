"""What a search has gone through stays true when one effect takes another's place."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast

import numpy as np

from tests.diagnosis.by_hand import EFFECTS, hypothesis
from tossid.diagnosis.likelihood.fitting import Fitted
from tossid.diagnosis.selection.cross_validation import Candidate
from tossid.diagnosis.selection.forward_selection import SelectionPath
from tossid.objects import ObjectModel


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
