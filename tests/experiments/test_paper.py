"""The study of the paper's claims: what is asked of it, and how its rows are made."""

from __future__ import annotations

from pathlib import Path

import pytest

from experiments import paper
from pipelines.cli.console import Console
from tests.models.made import tosses
from tossid.objects import ObjectModel
from tossid.store import Dataset, draw_splits


@pytest.mark.slow
def test_every_figure_is_measured(
    cube: ObjectModel, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    made = draw_splits(tuple(tosses(cube, 16, seed=3)), fractions=(0.5, 0.25, 0.25), seed=0)
    dataset = Dataset(cube, made, 148.0, "synthetic", {})
    monkeypatch.setattr("tossid.ingest", lambda *_, **__: dataset)
    paper.main(Path(), paper.Study(6, 2, (0,), (0.0,), (1.0,)), Console())
    lines = [line for line in capsys.readouterr().err.splitlines() if line.startswith("| ")]
    assert len(lines) == 2 + len(paper.CLAIMS)
    assert "not seen" in next(line for line in lines if "a vertex inside" in line)
