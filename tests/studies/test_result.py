"""What a study gives shows itself, saves itself, and draws what was swept."""

from __future__ import annotations

import csv
import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from matplotlib.figure import Figure

from tests.studies.made import computed, dataset
from tossid.models import TrainedModel, build_model, variant
from tossid.models.trained import checkpoint_bytes
from tossid.objects import ObjectModel
from tossid.settings.training import TrainSettings
from tossid.studies import study as studies
from tossid.studies.cells import StudyData, study_cells
from tossid.studies.result import Study
from tossid.studies.study import plan_study


@pytest.fixture
def study(cube: ObjectModel, monkeypatch: pytest.MonkeyPatch) -> Study:
    monkeypatch.setattr(studies, "compute_cell", computed)
    data = StudyData.of(dataset(cube))
    return plan_study(study_cells(data, key="hidden", values=[8, 16], models=["cnrp"], seeds=[0, 1]), data).run()


def test_it_shows_means_over_seeds(study: Study) -> None:
    assert study.table() == (
        ["model", "hidden", "gravity_ms2", "position_error_pct", "rotation_error_deg", "penetration_mm"],
        [["cnrp", "8", "8", "8", "8", "8"], ["cnrp", "16", "16", "16", "16", "16"]],
    )
    assert "2 held-out tosses" in repr(study)
    assert "<td>16</td>" in study._repr_html_()


def test_it_saves_its_rows_and_table(study: Study, tmp_path: Path) -> None:
    assert [path.name for path in study.save(tmp_path)] == ["cells.json", "cells.csv", "table.md"]
    rows = list(csv.DictReader((tmp_path / "cells.csv").read_text().splitlines()))
    assert [row["position_error_pct.high"] for row in rows] == ["9", "9", "17", "17"]
    assert json.loads((tmp_path / "cells.json").read_text()) == study.as_json()["cells"]
    assert len((tmp_path / "table.md").read_text().splitlines()) == 2 + 2


def test_the_model_of_a_row_is_read_from_memory_and_from_file(study: Study, cube: ObjectModel, tmp_path: Path) -> None:
    settings = TrainSettings(model=variant("cnrp"))
    trained = TrainedModel(build_model(settings.model, cube, seed=0), settings, {}, (), 1.0)
    path = trained.save(tmp_path / "model.pt")
    both = Study("hidden", study.rows[:2], (), study.held_out, (checkpoint_bytes(trained), path))
    assert both.model(0).settings == both.model(1).settings == settings


@pytest.fixture
def drawn_elsewhere(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("gravity_sweep", "data_efficiency", "inertia_study"):
        monkeypatch.setattr(f"tossid.evaluation.figures.{name}", lambda *args, **keys: Figure())


@pytest.mark.usefixtures("drawn_elsewhere")
@pytest.mark.parametrize(
    ("swept", "rows", "names"),
    [
        ("tosses", [{"from_flight": {}}, {"from_flight": {}}], ["data_efficiency", "data_efficiency_from_flight"]),
        ("tosses", [{"from_flight": {}}, {}], ["data_efficiency"]),
        ("start_inertia", [{}], ["inertia_study"]),
        ("hidden", [{"from_flight": {}}], []),
    ],
)
def test_a_study_has_the_figures_of_what_is_swept(
    cube: ObjectModel, swept: str, rows: list[dict[str, Any]], names: list[str]
) -> None:
    assert list(Study(swept, tuple(rows), (), dataset(cube), ()).figures()) == names


@pytest.mark.usefixtures("drawn_elsewhere")
def test_a_study_of_gravity_shows_the_k_res_of_its_most_wrong_gravity(
    cube: ObjectModel, monkeypatch: pytest.MonkeyPatch
) -> None:
    read = []

    def model(study: Study, row: int) -> TrainedModel:
        name, gravity = study.rows[row]["model"], study.rows[row]["gravity"]
        read.append((name, gravity))
        settings = TrainSettings(model=replace(variant(name), hidden=4, gravity=gravity))
        return TrainedModel(build_model(settings.model, cube), settings, {})

    monkeypatch.setattr(Study, "model", model)
    rows = tuple({"model": name, "gravity": gravity} for name in ("cn", "cnrp") for gravity in (9.81, 0.0, 19.7))
    held_out = dataset(cube).split("test")
    assert set(Study("gravity", rows, (), held_out, ()).figures()) == {"gravity_sweep", "residual_over_toss"}
    assert read == [("cn", 19.7), ("cnrp", 19.7)]  # cn has no k_res
    assert list(Study("gravity", rows[:3], (), held_out, ()).figures()) == ["gravity_sweep"]
