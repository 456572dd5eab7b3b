"""Tosses that the tests of sessions share."""

from __future__ import annotations

import numpy as np
import pytest

from tests.motion.bouncing import bounce, tracked
from tossid.objects import ObjectModel
from tossid.types import PoseTrack


@pytest.fixture(scope="package")
def tosses(cube: ObjectModel) -> list[PoseTrack]:
    """Forty tosses of the cube onto level ground, as measured."""
    rng = np.random.default_rng(11)
    return [
        tracked(truth, rng, name=str(i))
        for i, truth in enumerate(bounce(cube, rng, tosses=40, frames=110, gravity=9.81))
    ]
