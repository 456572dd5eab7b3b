"""The tables of a folder of drops hold what made them."""

from __future__ import annotations

import re
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from experiments.by_hand import die
from experiments.by_hand.die_impacts import impacts
from tests.experiments.by_hand.made_drops import LAW, make_drop


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
    rows = {
        (cells[0], cells[1]): cells[2:]
        for line in out.splitlines()
        if len(cells := re.split(r" *\| *", line)[1:-1]) == 5
    }
    value, interval, _ = rows["impacts of a lone corner", "rebound"]
    low, high = map(float, interval.split(" to "))
    assert low <= float(value) <= high
    assert float(value) == pytest.approx(LAW.rebound, abs=0.01)
    radius = float(rows["impacts of a lone corner", "radius of corners, by spin [mm]"][0])
    assert radius == pytest.approx(1e3 * LAW.radius, abs=0.5)
    assert float(rows["after it", "gravity [m/s²]"][0]) == pytest.approx(LAW.gravity, abs=0.05)
    none, one, two, three, _ = re.search(r"\| first \| (.*) \|", out)[1].split(" | ")
    assert int(none) > 5
    assert int(one) > 5
    assert (two, three) == ("0", "0")


def test_rebounds_are_listed_by_where_they_were(tmp_path: Path) -> None:
    rng, law = np.random.default_rng(1), replace(LAW, rebound=0.3)
    near = [make_drop(tmp_path / f"near_{k}.txt", rng) for k in range(8)]
    far = [make_drop(tmp_path / f"far_{k}.txt", rng, law) for k in range(8)]
    far = [replace(drop, x=drop.x + 1.0) for drop in far]
    hits = [hit for drop in near + far for hit in impacts(drop, np.array(LAW.half), np.array(LAW.centre), LAW.drag)]
    found = die.by_place(hits)
    assert sum(len(first) for first, _ in found.values()) == len(hits)
    for begin, (first, later) in found.items():
        assert first == pytest.approx(law.rebound if begin > 0.5 else LAW.rebound, abs=0.02)
        assert len(later) == 0
