"""The laws of impacts that made drops are found in them, with and without lost frames and rounded corners."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from experiments.by_hand.die_impacts import (
    Impact,
    contacts,
    correlations_of_impacts,
    impacts,
    of_impacts,
    radius_by_depth,
    radius_by_spin,
    scatter_of_impacts,
)
from tests.experiments.by_hand.made_drops import DT, LAW, Law, make_drop


def hits_of(folder: Path, law: Law, lost: list[int], *, twice: bool = False) -> list[Impact]:
    rng = np.random.default_rng(0)
    drops = [make_drop(folder / f"drop_{k:02d}.txt", rng, law, lost=n, twice=twice) for k, n in enumerate(lost)]
    return [hit for drop in drops for hit in impacts(drop, np.array(law.half), np.array(law.centre), law.drag)]


def test_what_made_impacts_is_found_in_them(tmp_path: Path) -> None:
    lost = [1 if k % 4 else 0 for k in range(40)]
    hits = hits_of(tmp_path, LAW, lost)
    assert len(hits) > 30
    assert [hit.lost for hit in hits] == [lost[int(hit.drop.removeprefix("drop_"))] for hit in hits]
    assert all(hit.first for hit in hits)
    assert all(0 <= hit.due <= DT for hit in hits)
    found = of_impacts(hits)
    assert found["rebound"] == pytest.approx(LAW.rebound, abs=0.005)
    assert found["sliding friction"] == pytest.approx(LAW.friction, abs=0.002)
    assert found["friction goes with the impulse to the power"] == pytest.approx(0, abs=0.1)
    assert found["radius of gyration² [mm²]"] == pytest.approx(1e6 * LAW.gyration, rel=0.02)
    assert found["radius of corners, by spin [mm]"] == pytest.approx(1e3 * LAW.radius, abs=0.2)
    assert found["radius of corners, by depth [mm]"] == pytest.approx(1e3 * LAW.radius, abs=0.2)
    assert found["the same, pressed in by the root of the speed [mm]"] == pytest.approx(1e3 * LAW.radius, abs=0.4)
    scatter = scatter_of_impacts(hits)
    assert np.ptp(scatter["rebound"]) < 0.01
    assert np.ptp(scatter["sliding friction"]) < 0.01
    assert np.abs(scatter["depth less that of round corners [mm]"]).max() < 0.1
    assert np.abs(scatter["change of spin less that of its impulse [rad/s]"]).max() < 0.3
    assert np.abs(scatter["the same, as an error of the arm [mm]"]).max() < 0.05
    assert np.abs(scatter["frames lost, less the whole number"]).max() < 0.1


def test_a_rebound_that_depends_on_the_place_correlates_with_it(tmp_path: Path) -> None:
    rng, hits = np.random.default_rng(5), []
    for k in range(30):
        place = 0.02 * k
        drop = make_drop(tmp_path / f"drop_{k:02d}.txt", rng, replace(LAW, rebound=0.3 + 0.4 * place))
        moved = replace(drop, x=drop.x + place)
        hits += impacts(moved, np.array(LAW.half), np.array(LAW.centre), LAW.drag)
    found = correlations_of_impacts(hits)
    assert found["place"][0] > 0.9
    assert max(abs(spin) for _, spin in found.values()) < 0.5
    assert "frames lost" not in found


def test_sharp_corners_and_whole_recordings_are_found_as_such(tmp_path: Path) -> None:
    law = replace(LAW, radius=0.0)
    hits = hits_of(tmp_path, law, [0] * 30)
    assert {hit.lost for hit in hits} == {0}
    assert radius_by_spin(hits)[0] == pytest.approx(0, abs=2e-4)
    assert radius_by_depth(hits)[0] == pytest.approx(0, abs=2e-4)


def test_corners_believed_sharp_leave_a_misfit_of_spins(tmp_path: Path) -> None:
    hits = hits_of(tmp_path, LAW, [0] * 30)
    sharp, round_ = contacts(hits, 0.0), contacts(hits, LAW.radius)
    np.testing.assert_allclose(round_.moment / round_.spin, LAW.gyration, rtol=0.05)
    assert np.ptp(np.percentile(sharp.moment / sharp.spin, [25, 75])) > 0.1 * LAW.gyration


def test_impacts_of_two_corners_join_for_no_number_of_lost_frames(tmp_path: Path) -> None:
    hits = hits_of(tmp_path, LAW, [0] * 10, twice=True)
    assert len(hits) > 3
    assert {hit.lost for hit in hits} == {None}


def test_depth_counts_from_the_floor_on_which_the_die_rests(tmp_path: Path) -> None:
    hits = hits_of(tmp_path, replace(LAW, floor=1e-3), [0] * 30)
    assert radius_by_depth(hits)[0] == pytest.approx(LAW.radius, abs=3e-4)
