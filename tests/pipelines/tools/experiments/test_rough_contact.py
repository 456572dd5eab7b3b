"""Predictions jump where contact makes them rough, and nowhere else."""

from __future__ import annotations

import numpy as np

from pipelines.tools.experiments.rough_contact import QUANTILES, WORLDS, jumps, table
from tests.diagnosis.tossed import seen
from tossid.diagnosis.likelihood.windows import make_windows
from tossid.objects import ObjectModel
from tossid.physics.effects import World
from tossid.settings.diagnosis.diagnose import DiagnoseSettings


def test_flight_is_smooth_and_contact_is_not(cube: ObjectModel) -> None:
    tosses = seen(World(cube), cube, 4, seed=3, frames=90)
    windows = make_windows(tosses, cube)
    found = jumps(windows, cube, {"restitution": [0.3], "cohesion": [0.05]})
    assert found.shape == windows.free.shape
    assert found[windows.free].max() < 1e-12
    assert np.median(found[~windows.free]) > 1e-7
    rows = table(tosses, cube, DiagnoseSettings()).splitlines()
    assert len(rows) == 2 + len(WORLDS)
    assert all(row.count("|") == 2 + len(QUANTILES) for row in rows)
