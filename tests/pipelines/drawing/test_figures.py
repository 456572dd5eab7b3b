"""Which figures a study has, and that they are written as files."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from matplotlib.figure import Figure

from pipelines.drawing import figures
from pipelines.drawing.figures import sweep_figures, write_figures


@pytest.mark.parametrize(
    ("key", "cells", "names"),
    [
        ("model.gravity", [{"from_flight": {}}, {"from_flight": {}}], ["gravity_sweep", "gravity_sweep_from_flight"]),
        ("model.gravity", [{"from_flight": {}}, {}], ["gravity_sweep"]),
        ("tosses", [{}], ["data_efficiency"]),
        ("model.start_inertia", [{}], ["inertia_study"]),
        ("optimizer", [{"from_flight": {}}], []),
    ],
)
def test_a_study_has_the_figures_of_its_key(
    monkeypatch: pytest.MonkeyPatch, key: str, cells: list[dict[str, Any]], names: list[str]
) -> None:
    for name in ("gravity_sweep", "data_efficiency", "inertia_study"):
        monkeypatch.setattr(f"tossid.evaluation.figures.{name}", lambda *args, **keys: Figure())
    assert list(figures.sweep_figures(key, cells, measured_penetration_mm=1.0)) == names
    assert sweep_figures("optimizer", cells, measured_penetration_mm=1.0) == {}


def test_figures_are_files_of_their_names(tmp_path: Path) -> None:
    paths = write_figures({"one": Figure(), "two": Figure()}, tmp_path / "new")
    assert [path.name for path in paths] == ["one.png", "two.png"]
    assert all(path.read_bytes()[:4] == b"\x89PNG" for path in paths)
