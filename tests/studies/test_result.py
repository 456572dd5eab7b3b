"""What a study gives shows itself, saves itself, and draws what was swept; errors against the truth."""

from __future__ import annotations

import csv
import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.figure import Figure

from pipelines.config.compose import load
from pipelines.config.schemas import TrainConfig
from tests.studies.made import computed, dataset
from tossid.models import TrainedModel, build_model, variant
from tossid.models.trained import checkpoint_bytes
from tossid.objects import ObjectModel
from tossid.settings.training import TrainSettings
from tossid.studies import study as studies
from tossid.studies.cells import StudyData, study_cells
from tossid.studies.result import Study
from tossid.studies.study import plan_study
from tossid.studies.tables import inertia_errors, markdown_table, study_row, validation_loss


@pytest.fixture
def study(cube: ObjectModel, monkeypatch: pytest.MonkeyPatch) -> Study:
    monkeypatch.setattr(studies, "compute_cell", computed)
    data = StudyData.of(dataset(cube))
    return plan_study(study_cells(data, key="hidden", values=[8, 16], models=["cnrp"], seeds=[0, 1]), data).run()


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


def test_it_shows_means_over_seeds_and_saves_its_rows(study: Study, tmp_path: Path) -> None:
    assert study.table() == (
        ["model", "hidden", "gravity_ms2", "position_error_pct", "rotation_error_deg", "penetration_mm"],
        [["cnrp", "8", "8", "8", "8", "8"], ["cnrp", "16", "16", "16", "16", "16"]],
    )
    assert "2 held-out tosses" in repr(study)
    assert "<td>16</td>" in study._repr_html_()
    assert [path.name for path in study.save(tmp_path)] == ["cells.json", "cells.csv", "table.md"]
    rows = list(csv.DictReader((tmp_path / "cells.csv").read_text().splitlines()))
    assert [row["position_error_pct.high"] for row in rows] == ["9", "9", "17", "17"]
    assert json.loads((tmp_path / "cells.json").read_text()) == study.as_json()["cells"]
    assert len((tmp_path / "table.md").read_text().splitlines()) == 2 + 2


# ---------------------------------------------------------------- rows


def cell(seed: int, gravity: float, found: float) -> dict[str, Any]:
    metrics = {
        name: {"mean": value + seed, "ci95": [value + seed - 1, value + seed + 2]}
        for name, value in (("position_error_pct", 10.0), ("rotation_error_deg", 20.0), ("penetration_mm", 1.0))
    }
    given = {"model": "cnrp", "seed": seed, "gravity": gravity, "seconds": 9.0 + seed, "validation_loss": 0.5}
    return {**given, **metrics, "gravity_ms2": {"mean": found, "ci95": [found, found]}, "from_flight": metrics}


def test_rows_are_means_over_seeds() -> None:
    cells = [cell(0, 0.0, 9.8), cell(1, 0.0, 9.6), cell(0, 9.81, 9.81)]
    head, _, one, other = markdown_table(cells, "gravity").splitlines()
    assert head.startswith("| model | given gravity [m/s²] | gravity found [m/s²] | of what was missing [%] |")
    assert one.startswith("| `cnrp` | 0 | 9.70 | 98.9 | 10.5 (9.5 to 12.5) | 20.5 (19.5 to 22.5) | 1.50 |")
    assert one.endswith("| 0.5 | 10 |")
    assert other.startswith("| `cnrp` | 9.81 | 9.81 | - | 10.0 (9.0 to 12.0) |")


def test_inertia_is_judged_along_its_worst_axis(cube: ObjectModel) -> None:
    config = load("train", TrainConfig, ["model.start_inertia=4", "model.start_com=[0,0.006,0.008]"]).model
    turned = np.linalg.qr(np.arange(9.0).reshape(3, 3) + np.eye(3))[0]
    learned = turned @ np.diag([1.02, 0.9, 1.0]) @ turned.T * cube.inertia[0, 0, 0]
    report = {"inertia_kgm2": [learned.tolist()], "com_m": [[0.0, 0.0, 0.002]]}
    found = inertia_errors(config, report, cube)
    assert found["inertia_error_rel"] == pytest.approx(0.1)
    assert found["com_error_m"] == pytest.approx(0.002)
    assert (found["parameterisation"], found["inertia_scale"]) == ("log_cholesky", 4.0)
    assert found["com_offset_m"] == pytest.approx(0.01)


def test_the_validation_loss_is_that_of_the_kept_parameters() -> None:
    rows = [("contact", 0.1), ("rollout-90", 0.4), ("rollout-90", 0.3), ("rollout-90", 0.35)]
    assert validation_loss([{"stage": stage, "validation_loss": loss} for stage, loss in rows]) == 0.3


def test_a_cell_has_its_errors_of_inertia_where_inertia_is_swept(cube: ObjectModel) -> None:
    config = load("train", TrainConfig, ["model.start_inertia=2"]).model
    parameters = {"inertia_kgm2": (1.1 * cube.inertia).tolist(), "com_m": cube.com.tolist()}
    history = [{"stage": "contact", "validation_loss": 0.2}]
    about = {"model": "cnrpi", "seed": 0, "start_inertia": 2.0}
    found = study_row(about, {"parameters": parameters, "seconds": 3.0}, history, settings=config, truth=cube)
    assert found["inertia_error_rel"] == pytest.approx(0.1)
    assert (found["validation_loss"], found["seconds"], found["model"]) == (0.2, 3.0, "cnrpi")
    other = {"model": "cnrpi", "seed": 0, "gravity": 2.0}
    plain = study_row(other, {"parameters": parameters, "seconds": 3.0}, history, settings=config, truth=cube)
    assert "inertia_error_rel" not in plain
