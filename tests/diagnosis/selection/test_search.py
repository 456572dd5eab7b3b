"""Contact decides what flight cannot distinguish, and the search names effects of either."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.diagnosis.by_hand import EFFECTS
from tests.diagnosis.tossed import ONCE, seen
from tossid.diagnosis.explain import explain
from tossid.diagnosis.problem import Problem
from tossid.objects import ObjectModel
from tossid.physics.effects import RecordingErrors, World


@pytest.mark.slow
def test_contact_decides_what_flight_cannot_distinguish(cube: ObjectModel) -> None:
    """A missing bounce hides the height at which a shorter unit of length lets the cube rest."""
    truth = replace(
        EFFECTS["restitution"].at(World(cube), np.array([0.35])), recording=RecordingErrors(length_scale=0.985)
    )
    library = [EFFECTS[name] for name in ("gravity", "length_scale", "time_base", "restitution")]
    found = explain(Problem(seen(truth, cube, 16, seed=2), World(cube), library=library, settings=ONCE))
    assert set(found.named) == {"restitution", "length_scale"}
    bounce = next(each for each in found.findings if each.name == "restitution").parameters["e"]
    # steps eight times as long as those of the tosses bias it by 0.6 %, which is as much as its interval's half-width
    assert bounce.value == pytest.approx(0.35, rel=0.01)
    assert found.left.total.value < 1.3
