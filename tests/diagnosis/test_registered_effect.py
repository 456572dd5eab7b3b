"""A diagnosis finds an effect that a user has registered."""

from __future__ import annotations

import numpy as np
import pytest

from tests.diagnosis.tossed import seen
from tests.physics.effects.toy import registered
from tossid.diagnosis.diagnose import diagnose
from tossid.objects import ObjectModel
from tossid.physics.effects import LIBRARY, World
from tossid.store import Dataset

KEPT = ("gravity", "friction", "uniform_force")


@pytest.mark.slow
def test_a_registered_effect_is_named(cube: ObjectModel) -> None:
    with registered() as effect:
        true = effect.at(World(cube), np.array([2.0]))
        dataset = Dataset(cube, tuple(seen(true, cube, 10, seed=5)), 148.0, "made", {})
        without = tuple(other.name for other in LIBRARY if other.name not in KEPT)
        gap = diagnose(dataset, World(cube), without=without, threads=1, repeats=0)
    assert gap.named == ("height_pull",)
    found = next(finding for finding in gap.findings if finding.name == "height_pull").parameters["k_npm"]
    assert found.low - 0.05 < 2.0 < found.high + 0.05
    assert gap.patch is not None
    assert gap.patch["keys"]["forces.HeightPull.k_npm"]["before"] is None
    assert gap.patch["not_expressed"] == {"height_pull": "MJCF has no force that depends on height"}
