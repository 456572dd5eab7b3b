"""What made drops of a die is found in them, with and without lost frames and rounded corners."""

from __future__ import annotations

import re
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from experiments.by_hand import die
from experiments.by_hand.die_recording import (
    flights,
    lost_in_flight,
    with_true_times,
)
from tests.experiments.by_hand.made_drops import DT, LAW, make_drop

HALF = np.array(LAW.half)


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
    for where, figure, truth in (
        ("flight, after the first impact", "gravity [m/s²]", pytest.approx(LAW.gravity, abs=0.05)),
        ("impacts of a lone corner", "rebound", pytest.approx(LAW.rebound, abs=0.01)),
        ("impacts of a lone corner", "sliding friction", pytest.approx(LAW.friction, abs=0.005)),
        ("impacts of a lone corner", "radius of gyration² [mm²]", pytest.approx(1e6 * LAW.gyration, rel=0.02)),
        ("impacts of a lone corner", "radius of corners, by spin [mm]", pytest.approx(1e3 * LAW.radius, abs=0.2)),
        ("impacts of a lone corner", "radius of corners, by depth [mm]", pytest.approx(1e3 * LAW.radius, abs=0.5)),
    ):
        value, interval, _ = rows[where, figure]
        assert float(value) == truth, figure
        low, high = map(float, interval.split(" to "))
        assert low <= float(value) <= high
    none, one, two, three, _ = re.search(r"\| first \| (.*) \|", out)[1].split(" | ")
    assert min(int(none), int(one)) > 5
    assert (two, three) == ("0", "0")


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
