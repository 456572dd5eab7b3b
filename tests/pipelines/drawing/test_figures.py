"""Figures are written as files."""

from __future__ import annotations

from pathlib import Path

from matplotlib.figure import Figure

from pipelines.drawing.figures import write_figures


def test_figures_are_files_of_their_names(tmp_path: Path) -> None:
    paths = write_figures({"one": Figure(), "two": Figure()}, tmp_path / "new")
    assert [path.name for path in paths] == ["one.png", "two.png"]
    assert all(path.read_bytes()[:4] == b"\x89PNG" for path in paths)
