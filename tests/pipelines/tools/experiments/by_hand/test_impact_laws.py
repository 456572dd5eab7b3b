"""The law by which impacts were made is the one that leaves less of them, at their values."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pipelines.tools.experiments.by_hand.impact_laws import LAWS, fitted, table
from tests.diagnosis.tossed import seen
from tossid.diagnosis.localisation.witnesses import lone_impacts
from tossid.objects import ObjectModel
from tossid.physics.effects import World


@pytest.mark.parametrize("truth", [pytest.param("after the impact", marks=pytest.mark.slow), "as it turns (Routh)"])
def test_the_law_that_made_impacts_leaves_less(cube: ObjectModel, truth: str) -> None:
    world = World(cube.with_changes(restitution=0.3, friction=0.25, inertia=1.2 * cube.inertia))
    made = replace(world, law=world.law._replace(impulse_parts=float(LAWS[truth])))
    hit = lone_impacts(seen(made, cube, 60, seed=3, frames=40), world)
    assert len(hit.toss) >= 10
    left = {}
    for name, parts in LAWS.items():
        values, misfit = fitted(hit, cube, parts)
        left[name] = float(np.median(np.abs(misfit)))
        if name == truth:
            np.testing.assert_allclose(values, [1.2, 1.2, 1.2, 0.3, 0.25], rtol=0.06)
    other = next(name for name in LAWS if name != truth)
    assert left[truth] < 0.7 * left[other]
    assert f"| {truth} |" in table(hit, cube)
