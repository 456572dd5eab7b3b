"""The study of random starts: what is asked of it, and what its rows say."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from experiments import starts
from pipelines.cli.console import Console
from tests.models.made import tosses
from tossid.objects import ObjectModel
from tossid.store import Dataset, draw_splits


@pytest.mark.slow
def test_rows_say_where_a_start_ended(
    cube: ObjectModel, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    made = draw_splits(tuple(tosses(cube, 40, seed=3)), fractions=(0.7, 0.15, 0.15), seed=0)
    dataset = Dataset(cube, made, 148.0, "synthetic", {})
    monkeypatch.setattr("tossid.ingest", lambda *_, **__: replace(dataset))
    starts.main(Path(), starts.Study("cn", 20, True, 2), Console())
    lines = capsys.readouterr().err.splitlines()
    rows = [[cell.strip() for cell in line.split("|")[1:-1]] for line in lines if line.startswith("| `cn`")]
    columns = starts.HEAD.split("|")
    assert [row[columns.index("start")] for row in rows] == ["stated", "0", "1"]
    assert {len(row) for row in rows} == {len(columns)}
    assert all(float(row[columns.index("corners apart [mm]")]) < 2 for row in rows)
    # rollouts of tosses without noise miss by 1 %, of which 3 % decide nothing
    assert "where the stated start ends (corners 2, friction 2, " in lines[-1]
