"""Effects are also looked for far from nothing: in the order of their starts, with first states of their own."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from tests.diagnosis.by_hand import EFFECTS
from tests.diagnosis.tossed import seen
from tossid.diagnosis.likelihood.evidence import Evidence, Hypothesis
from tossid.diagnosis.selection.cross_validation import CrossValidator
from tossid.diagnosis.selection.screening import _beside, _beyond, screen
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


def test_values_beside_a_start_are_halfway_to_its_neighbours(cube: ObjectModel) -> None:
    starts = [with_start(cube, "geometry", dict(each)) for each in EFFECTS["geometry"].starts]
    nothing = Hypothesis(World(cube)).plus(EFFECTS["geometry"])

    def sizes(start: Hypothesis) -> list[float]:
        return [float(each.values[-1][0]) for each in _beside(start, starts, nothing)]

    assert sizes(starts[1]) == pytest.approx([0.9475, 0.9775])
    assert sizes(starts[2]) == pytest.approx([0.9775, 0.995])
    assert sizes(starts[5]) == pytest.approx([1.0525])


def test_starts_of_several_parameters_have_no_order(cube: ObjectModel) -> None:
    starts = [with_start(cube, "compliance", dict(each)) for each in EFFECTS["compliance"].starts]
    nothing = Hypothesis(World(cube)).plus(EFFECTS["compliance"])
    assert _beyond(starts[0], starts, nothing) == []
    assert _beside(starts[0], starts, nothing) == []


@pytest.mark.parametrize("size", [0.94, 1.062])
def test_a_size_far_off_is_reached(cube: ObjectModel, size: float) -> None:
    tosses = seen(World(cube.with_changes(corner_pos=size * cube.corner_pos)), cube, 8, seed=5)
    judge = CrossValidator.of(tosses, cube, seed=0)
    found = screen(judge, judge.evaluate(Hypothesis(World(cube))), EFFECTS["geometry"])
    assert found.gain > 100
    assert found.start.values[-1][0] == pytest.approx(size, abs=0.012)


@pytest.mark.parametrize(("hopeless", "restarted"), [(10.0, False), (1e9, True)])
def test_windows_are_not_restarted_at_a_start_that_loses_much(
    cube: ObjectModel, monkeypatch: pytest.MonkeyPatch, hopeless: float, restarted: bool
) -> None:
    judge = CrossValidator.of(seen(World(cube), cube, 8, seed=5), cube, seed=0)
    selection = replace(judge.settings.selection, hopeless=hopeless)
    judge = replace(judge, settings=replace(judge.settings, selection=selection))
    present, asked, original = judge.evaluate(Hypothesis(World(cube))), [], Evidence.relinearised

    def counted(self: Evidence, world: World, **keys: Any) -> Evidence:
        asked.append(keys.get("restarts", 0))
        return original(self, world, **keys)

    monkeypatch.setattr(Evidence, "relinearised", counted)
    assert not screen(judge, present, EFFECTS["geometry"]).from_start
    assert (1 in asked) == restarted
