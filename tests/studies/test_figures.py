"""Which figures a study has, and whose accelerations they show."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest
from matplotlib.figure import Figure

from tests.models.made import tosses
from tossid.models import TrainedModel, build_model, variant
from tossid.objects import ObjectModel
from tossid.settings.training import TrainSettings
from tossid.store import Dataset
from tossid.studies.figures import study_figures
from tossid.studies.tables import Row


@pytest.fixture
def held_out(cube: ObjectModel) -> Dataset:
    return Dataset(cube, tuple(tosses(cube, 2, seed=2, frames=40)), 148.0, "made")


@pytest.fixture(autouse=True)
def _drawn_elsewhere(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("gravity_sweep", "data_efficiency", "inertia_study"):
        monkeypatch.setattr(f"tossid.evaluation.figures.{name}", lambda *args, **keys: Figure())


@pytest.mark.parametrize(
    ("swept", "cells", "names"),
    [
        ("tosses", [{"from_flight": {}}, {"from_flight": {}}], ["data_efficiency", "data_efficiency_from_flight"]),
        ("tosses", [{"from_flight": {}}, {}], ["data_efficiency"]),
        ("start_inertia", [{}], ["inertia_study"]),
        ("hidden", [{"from_flight": {}}], []),
    ],
)
def test_a_study_has_the_figures_of_what_is_swept(
    held_out: Dataset, swept: str, cells: list[dict[str, Any]], names: list[str]
) -> None:
    def no_model(cell: Row) -> TrainedModel:
        raise AssertionError("no model is needed")

    assert list(study_figures(swept, cells, held_out, model_of=no_model)) == names


def test_a_study_of_gravity_shows_the_k_res_of_its_most_wrong_gravity(held_out: Dataset) -> None:
    asked = []

    def model_of(cell: Row) -> TrainedModel:
        asked.append((cell["model"], cell["gravity"]))
        settings = TrainSettings(model=replace(variant(cell["model"]), hidden=4, gravity=cell["gravity"]))
        return TrainedModel(build_model(settings.model, held_out.object), settings, {})

    cells = [{"model": name, "gravity": gravity} for name in ("cn", "cnrp") for gravity in (9.81, 0.0, 19.7)]
    found = study_figures("gravity", cells, held_out, model_of=model_of)
    assert set(found) == {"gravity_sweep", "residual_over_toss"}
    assert asked == [("cn", 19.7), ("cnrp", 19.7)]  # cn has no k_res
    assert list(study_figures("gravity", cells[:3], held_out, model_of=model_of)) == ["gravity_sweep"]
