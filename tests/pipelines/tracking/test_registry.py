"""A registered model's answers. `test_export` has its shapes, and that it is no pickle."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from pipelines.tracking.registry import EXAMPLE_STEPS, FRAME, Served, write_model
from tossid.models import TrainedModel, build_model, variant
from tossid.objects import ObjectModel
from tossid.settings.training import TrainSettings


@pytest.fixture(scope="module")
def trained(elbow: ObjectModel) -> TrainedModel:
    settings = TrainSettings(model=variant("cn"))
    return TrainedModel(build_model(settings.model, elbow), settings, {}, sha256="ab")


def test_a_call_without_a_length_is_one_frame(trained: TrainedModel) -> None:
    q, v = np.zeros((2, 8)), np.zeros((2, 7))
    q[:, 2:4], v[:, 0] = 1.0, 0.5
    found = Served(trained).predict({"q": q.tolist(), "v": v.tolist()})
    assert found["q"].shape == (2, 2, 8)
    assert found["q"][:, 1, 0] == pytest.approx(0.5 * FRAME)
    longer = Served(trained).predict({"q": q, "v": v}, {"n_steps": 3, "dt": 0.01})
    assert longer["v"].shape == (2, 4, 7)
    assert longer["q"][:, 3, 0] == pytest.approx(0.5 * 0.03)


def test_the_example_is_a_call_that_the_model_answers(trained: TrainedModel, tmp_path: Path) -> None:
    from mlflow.models import Model

    folder = tmp_path / "registered"
    write_model(trained.save(tmp_path / "model.pt"), folder)
    call = json.loads(Model.load(str(folder)).get_serving_input(str(folder)))
    found = Served(trained).predict(call["inputs"], call["params"])
    assert found["q"].shape == (1, EXAMPLE_STEPS + 1, 8)
    assert found["q"][0, -1, 0] > 0.2
