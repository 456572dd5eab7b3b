"""Figures are written as files."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from pipelines.drawing.figures import stages_of, write_figures
from tossid.objects import ObjectModel


def test_figures_are_files_of_their_names(tmp_path: Path) -> None:
    paths = write_figures({"one": Figure(), "two": Figure()}, tmp_path / "new")
    assert [path.name for path in paths] == ["one.png", "two.png"]
    assert all(path.read_bytes()[:4] == b"\x89PNG" for path in paths)


def test_the_stages_of_corners_is_in_true_lengths_and_of_all_links(elbow: ObjectModel) -> None:
    steps = [elbow.corner_pos + 0.01, elbow.corner_pos]
    own = [elbow.corner_body == body for body in range(elbow.n_bodies)]
    links = [{"way_m": [(2 * step[which]).tolist() for step in steps]} for which in own]
    model = SimpleNamespace(learned_object=lambda: elbow, measurement=SimpleNamespace(length_scale=2.0))
    trained: Any = SimpleNamespace(parameters={"geometry": links}, model=model)
    np.testing.assert_allclose(stages_of(trained), steps)
    trained.parameters = {"geometry": [{"way_m": []}, {"way_m": []}]}
    assert stages_of(trained) == []
