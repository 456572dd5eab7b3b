"""Tosses that several tests of motion share."""

from __future__ import annotations

import numpy as np
import pytest

from tests.motion.bouncing import bounce, tracked
from tossid.objects import ObjectModel
from tossid.types import PoseTrack


@pytest.fixture(scope="package")
def cube_tracks(cube: ObjectModel) -> list[PoseTrack]:
    """Forty tosses of the cube onto level ground until they rest, as measured."""
    rng = np.random.default_rng(11)
    truths = bounce(cube, rng, tosses=40, frames=220)
    return [tracked(truth, rng, name=str(i)) for i, truth in enumerate(truths)]


@pytest.fixture(scope="session")
def odd(cube: ObjectModel) -> ObjectModel:
    """A body whose recorded frame is off its centre of mass, with three different moments of inertia."""
    return cube.with_changes(com=np.array([[0.01, -0.005, 0.008]]), inertia=np.diag([6e-4, 9e-4, 1.2e-3])[None])
