"""What made drops of a die is found in them, with and without lost frames and rounded corners."""

from __future__ import annotations

import re
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from experiments.by_hand import die
from experiments.by_hand.die import Impact, flights_of, impacts, of_flight, of_impacts, radius_by_depth, radius_by_spin
from experiments.by_hand.die_recording import (
    TURNING,
    flights,
    floor_of,
    halves,
    heights_by_face,
    lost_in_flight,
    rest,
    with_true_times,
)
from tests.experiments.by_hand.made_drops import DT, LAW, Law, make_drop

HALF = np.array(LAW.half)


def hits_of(folder: Path, law: Law, lost: list[int], *, twice: bool = False) -> list[Impact]:
    rng = np.random.default_rng(0)
    drops = [make_drop(folder / f"drop_{k:02d}.txt", rng, law, lost=n, twice=twice) for k, n in enumerate(lost)]
    return [hit for drop in drops for hit in impacts(drop, np.array(law.half), np.array(law.centre), law.drag)]


def test_the_tables_hold_what_made_the_drops(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    rng = np.random.default_rng(0)
    for k in range(32):
        make_drop(tmp_path / f"drop_{k:02d}.txt", rng, lost=k % 2)
    monkeypatch.setattr(die, "RESAMPLES", 20)
    monkeypatch.setattr(sys, "argv", ["die", str(tmp_path)])
    die.main()
    out = capsys.readouterr().out
    cells = [re.split(r" *\| *", line)[1:-1] for line in out.splitlines()]
    rows = {(row[0], row[1]): row[2:] for row in cells if len(row) == 5}
    value, interval, _ = rows["impacts of a lone corner", "rebound"]
    low, high = map(float, interval.split(" to "))
    assert low <= float(value) <= high
    assert float(value) == pytest.approx(LAW.rebound, abs=0.01)
    gravity = float(rows["flight, after the first impact", "gravity [m/s²]"][0])
    assert gravity == pytest.approx(LAW.gravity, abs=0.05)
    none, one, two, three, _ = re.search(r"\| first \| (.*) \|", out)[1].split(" | ")
    assert min(int(none), int(one)) > 5
    assert (two, three) == ("0", "0")


def test_what_made_flights_is_found_in_them(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    drops = [make_drop(tmp_path / f"drop_{k:02d}.txt", rng) for k in range(40)]
    found = of_flight([flight for drop in drops for flight in flights_of(drop, HALF) if not flight.first])
    assert found["gravity [m/s²]"] == pytest.approx(LAW.gravity, abs=0.02)
    assert found["drag [1/s]"] == pytest.approx(LAW.drag, abs=0.02)
    assert found["centre of mass, x [mm]"] == pytest.approx(1e3 * LAW.centre[0], abs=0.05)
    assert found["centre of mass, z [mm]"] == pytest.approx(1e3 * LAW.centre[1], abs=0.05)


def test_what_made_impacts_is_found_in_them(tmp_path: Path) -> None:
    lost = [1 if k % 4 else 0 for k in range(40)]
    hits = hits_of(tmp_path, LAW, lost)
    assert len(hits) > 30
    assert [hit.lost for hit in hits] == [lost[int(hit.drop.removeprefix("drop_"))] for hit in hits]
    assert all(hit.first for hit in hits)
    found = of_impacts(hits)
    assert found["rebound"] == pytest.approx(LAW.rebound, abs=0.005)
    assert found["sliding friction"] == pytest.approx(LAW.friction, abs=0.002)
    assert found["radius of gyration² [mm²]"] == pytest.approx(1e6 * LAW.gyration, rel=0.02)
    assert found["radius of corners, by spin [mm]"] == pytest.approx(1e3 * LAW.radius, abs=0.2)
    assert found["radius of corners, by depth [mm]"] == pytest.approx(1e3 * LAW.radius, abs=0.2)


def test_sharp_corners_are_found_as_such(tmp_path: Path) -> None:
    hits = hits_of(tmp_path, replace(LAW, radius=0.0), [0] * 30)
    assert {hit.lost for hit in hits} == {0}
    assert radius_by_spin(hits)[0] == pytest.approx(0, abs=2e-4)
    assert radius_by_depth(hits) == pytest.approx(0, abs=2e-4)


def test_impacts_of_two_corners_join_for_no_number_of_lost_frames(tmp_path: Path) -> None:
    hits = hits_of(tmp_path, LAW, [0] * 10, twice=True)
    assert len(hits) > 3
    assert {hit.lost for hit in hits} == {None}


def test_frames_lost_in_flight_are_counted_where_they_are_missing(tmp_path: Path) -> None:
    rng = np.random.default_rng(1)
    for k in range(10):
        drop = make_drop(tmp_path / f"drop_{k}.txt", rng)
        assert not lost_in_flight(drop, HALF).any()
        after = flights(drop, HALF)[1]
        kept = np.setdiff1d(np.arange(len(drop.t)), [after.start + 5, after.start + 6, after.start + 11])
        lossy = replace(drop, t=DT * np.arange(len(kept)), x=drop.x[kept], z=drop.z[kept], angle=drop.angle[kept])
        lost = lost_in_flight(lossy, HALF)
        assert np.flatnonzero(lost).tolist() == [after.start + 4, after.start + 8]
        np.testing.assert_allclose(with_true_times(lossy, lost).t, drop.t[kept], atol=1e-9)


def test_flights_leave_out_the_impact_also_where_its_frames_are_lost(tmp_path: Path) -> None:
    rng, seen = np.random.default_rng(2), 0
    for k in range(30):
        drop = make_drop(tmp_path / f"drop_{k}.txt", rng, lost=2)
        lowest = int(np.argmin(drop.z[:20]))
        if drop.z[lowest + 1] - drop.z[lowest] > TURNING:
            seen += 1
            assert all(not flight.start <= lowest < flight.stop for flight in flights(drop, HALF))
    assert seen > 10


def test_sides_and_floor_are_those_on_which_the_die_rests(tmp_path: Path) -> None:
    rng, law = np.random.default_rng(3), replace(LAW, floor=5e-4)
    drops = [make_drop(tmp_path / f"drop_{k:02d}.txt", rng, law) for k in range(30)]
    assert {face for face, _ in filter(None, map(rest, drops))} == {0, 1, 2, 3}
    half = halves(heights_by_face(drops), 0.03)
    np.testing.assert_allclose(half, HALF, atol=2e-5)
    assert [floor_of(drop, half) for drop in drops] == pytest.approx([5e-4] * 30, abs=3e-5)
    moving = replace(drops[0], x=drops[0].x + 0.1 * drops[0].t)
    assert np.isnan(floor_of(moving, HALF))
