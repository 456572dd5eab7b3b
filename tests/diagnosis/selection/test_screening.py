"""Effects are also looked for far from nothing: in the order of their starts, with first states of their own."""

from __future__ import annotations

import numpy as np
import pytest

from tests.diagnosis.by_hand import EFFECTS
from tests.diagnosis.tossed import seen
from tossid.diagnosis.likelihood.evidence import Hypothesis
from tossid.diagnosis.selection.cross_validation import CrossValidator
from tossid.diagnosis.selection.screening import _beyond, screen
from tossid.objects import ObjectModel
from tossid.physics.effects import World


def with_start(cube: ObjectModel, name: str, start: dict[str, float]) -> Hypothesis:
    effect, nothing = EFFECTS[name], Hypothesis(World(cube))
    values = {**effect.named(effect.nominal(World(cube))), **start}
    return nothing.plus(effect, np.array([values[p.name] for p in effect.parameters]))


def test_starts_beyond_one_are_on_its_side_and_nearest_first(cube: ObjectModel) -> None:
    starts = [with_start(cube, "geometry", dict(each)) for each in reversed(EFFECTS["geometry"].starts)]
    nothing = Hypothesis(World(cube)).plus(EFFECTS["geometry"])
    assert [each.values[-1][0] for each in _beyond(starts[2], starts, nothing)] == [1.035, 1.07]
    assert [each.values[-1][0] for each in _beyond(starts[3], starts, nothing)] == [0.965, 0.93]
    assert _beyond(starts[0], starts, nothing) == []


def test_starts_of_several_parameters_have_no_order(cube: ObjectModel) -> None:
    starts = [with_start(cube, "compliance", dict(each)) for each in EFFECTS["compliance"].starts]
    assert _beyond(starts[0], starts, Hypothesis(World(cube)).plus(EFFECTS["compliance"])) == []


@pytest.mark.parametrize("size", [0.94, 1.062])
def test_a_size_far_off_is_reached(cube: ObjectModel, size: float) -> None:
    tosses = seen(World(cube.with_changes(corner_pos=size * cube.corner_pos)), cube, 8, seed=5)
    judge = CrossValidator.of(tosses, cube, seed=0)
    found = screen(judge, judge.evaluate(Hypothesis(World(cube))), EFFECTS["geometry"])
    assert found.gain > 100
    assert found.start.values[-1][0] == pytest.approx(size, abs=0.012)
