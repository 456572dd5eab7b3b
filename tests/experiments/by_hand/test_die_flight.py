"""Gravity, drag and the centre of mass that made flights are found in them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from experiments.by_hand.die_flight import flights_of, of_first_flight, of_flight
from tests.experiments.by_hand.made_drops import LAW, make_drop


def test_what_made_flights_is_found_in_them(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    drops = [make_drop(tmp_path / f"drop_{k:02d}.txt", rng) for k in range(40)]
    flying = [flight for drop in drops for flight in flights_of(drop, np.array(LAW.half))]
    found = of_flight([flight for flight in flying if not flight.first])
    assert found["gravity [m/s²]"] == pytest.approx(LAW.gravity, abs=0.02)
    assert found["drag [1/s]"] == pytest.approx(LAW.drag, abs=0.02)
    assert found["drag, spin [1/s]"] == pytest.approx(LAW.drag, abs=0.02)
    assert found["centre of mass, x [mm]"] == pytest.approx(1e3 * LAW.centre[0], abs=0.05)
    assert found["centre of mass, z [mm]"] == pytest.approx(1e3 * LAW.centre[1], abs=0.05)


def test_a_first_frame_that_is_off_along_z_alone_is_no_matter_of_time(tmp_path: Path) -> None:
    rng = np.random.default_rng(1)
    drops = [make_drop(tmp_path / f"drop_{k:02d}.txt", rng) for k in range(40)]
    off = [replace(drop, z=drop.z + np.where(drop.t == 0, -2e-4, 0.0)) for drop in drops]
    late = [replace(drop, t=drop.t + np.where(drop.t == 0, -1e-4, 0.0)) for drop in drops]
    found, of_time = (
        of_first_flight([f for drop in some for f in flights_of(drop, np.array(LAW.half)) if f.first])
        for some in (off, late)
    )
    assert found["falls at [m/s²]"] == pytest.approx(LAW.gravity - 1.8 * LAW.drag, abs=0.2)
    assert found["first frame is too high by [mm]"] == pytest.approx(-0.2, abs=0.02)
    assert abs(found["if it were late, by x [ms]"]) < 0.3 * found["if it were late, by z [ms]"]
    assert of_time["if it were late, by x [ms]"] == pytest.approx(of_time["if it were late, by z [ms]"], rel=0.3)
