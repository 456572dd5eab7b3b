"""What several tests of likelihoods start from."""

from __future__ import annotations

import numpy as np
import pytest

from tests.diagnosis.by_hand import EFFECTS
from tests.diagnosis.tossed import seen
from tossid.diagnosis.likelihood.evidence import Evidence, Hypothesis
from tossid.diagnosis.likelihood.whitening import linearise
from tossid.diagnosis.likelihood.windows import make_windows
from tossid.objects import ObjectModel
from tossid.physics.effects import World


@pytest.fixture(scope="module")
def of_flight(cube: ObjectModel) -> tuple[Evidence, Hypothesis]:
    """Free flights under 9.7 m/s², around the nominal gravity."""
    tosses = seen(World(cube, gravity=9.7), cube, 12, seed=2)
    windows = make_windows(tosses, cube)
    windows = windows.rows(np.flatnonzero(windows.free))
    return Evidence(*linearise(windows, World(cube))), Hypothesis(World(cube)).plus(EFFECTS["gravity"])
