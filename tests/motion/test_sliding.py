"""Friction from what slides, against the truth."""

from __future__ import annotations

import numpy as np
import pytest

from tests.models.made import flights, tosses
from tossid.motion.sliding import sliding_friction
from tossid.objects import ObjectModel


@pytest.mark.parametrize("friction", [0.12, 0.3])
def test_friction_is_recovered_whatever_the_inertia(cube: ObjectModel, friction: float) -> None:
    made = tosses(cube.with_changes(friction=friction), 24, seed=1, frames=110, substeps=16)
    for inertia in (cube.inertia, 3 * cube.inertia):
        found = sliding_friction(made, cube.with_changes(inertia=inertia, friction=0.9))
        assert found.tosses >= 8
        assert found.deviation < 0.01
        assert found.friction == pytest.approx(friction, abs=max(3 * found.deviation, 0.003))


def test_what_only_flies_shows_none(cube: ObjectModel) -> None:
    found = sliding_friction(flights(cube, 4), cube)
    assert np.isnan(found.friction)
    assert (found.deviation, found.tosses) == (np.inf, 0)
