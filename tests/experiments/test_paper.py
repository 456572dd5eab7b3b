"""The study of the paper's claims: what is asked of it, and how its rows are made."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from experiments import paper
from pipelines.cli.console import Console
from tests.models.made import tosses
from tossid.objects import ObjectModel
from tossid.store import Dataset, draw_splits


def test_arguments(tmp_path: Path) -> None:
    assert paper.parsed([str(tmp_path)]) == (tmp_path, paper.Study())
    asked = [str(tmp_path), "--tosses", "9", "--seeds", "1", "--gravities", "0", "--inertias", "0.5", "2"]
    assert paper.parsed(asked)[1] == paper.Study(9, 100, (0,), (0.0,), (0.5, 2.0))


class Given(paper.Runs):
    """Runs whose figures are given."""

    def of(self, model: str, gravity: float) -> list[paper.Measured]:
        """cnrp finds 80 % of what is missing; each model's errors are its number."""
        number = list(paper.OURS).index(model) + 1.0
        self.heights = [7.0, 8.0]
        found = gravity + 0.8 * (9.81 - gravity) if model == "cnrp" else gravity
        return [paper.Measured(10 * number + s, number, 0.1 * number, 1.5, found, 0.5) for s in (0, 2)]


def test_claims_are_figures_of_the_runs(cube: ObjectModel) -> None:
    made = draw_splits(tuple(tosses(cube, 10, seed=3)), fractions=(0.6, 0.2, 0.2), seed=0)
    dataset = Dataset(cube, made, 148.0, "synthetic", {})
    study = paper.Study(4, 2, (0, 1), (0.0, 19.62), (0.5, 2.0))
    said = paper.claims(Given(dataset, study, paper.OURS, Console()), np.array([0.95, 1.4]), (0.25, False))
    assert said[:3] == ["80 to 80 %", "+10.0 %, +1.0 deg", "+10.0 %, +1.0 deg"]
    assert said[3:5] == ["0.10, 0.20, 0.30 mm; recorded 1.50 mm", "ends at 7.50 m, 11 % off"]
    assert said[6:] == ["moved by 0.25 mm, not seen", "starts 0.5 of 0.5, 2"]
    rows = paper.table([said, said])
    assert len(rows) == 2 + len(paper.CLAIMS)
    assert {row.count("|") for row in rows} == {5}


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
