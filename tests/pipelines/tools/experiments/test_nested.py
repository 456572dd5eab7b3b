"""Judging folds beside a search that is repeated without each fold."""

from __future__ import annotations

import pytest

from pipelines.tools.experiments.nested import compare
from tests.diagnosis.tossed import seen
from tossid.objects import ObjectModel
from tossid.physics.effects import World, effect_named
from tossid.store import Dataset


@pytest.mark.slow
def test_both_close_what_friction_makes(cube: ObjectModel) -> None:
    tosses = seen(World(cube.with_changes(friction=0.3)), cube, 16, seed=4, frames=60)
    found = compare(Dataset(cube, tuple(tosses), 148.0, "made", {}), [effect_named("friction")], folds=2)
    assert found["named"] == ["friction"]
    assert [each["named"] for each in found["exact"]] == [["friction"]] * 2
    assert sum(each["n_tosses"] for each in found["exact"]) == 16
    assert found["exact_closed"] > 0.7
    assert found["closed"]["value"] == pytest.approx(found["exact_closed"], abs=0.15)
