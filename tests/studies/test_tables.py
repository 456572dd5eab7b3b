"""A study's tables: errors against the truth, and means over seeds."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from pipelines.config.compose import load
from pipelines.config.schemas import TrainConfig
from tossid.objects import ObjectModel
from tossid.studies.tables import inertia_errors, markdown_table, study_row, validation_loss


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
