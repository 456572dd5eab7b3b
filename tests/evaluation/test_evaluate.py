"""`tossid.evaluate` and `tossid.export`: the scores of a model that is the truth, and MuJoCo beside the model."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest
import torch

import tossid
from tests.models.made import tosses
from tossid.errors import ConfigError, InputError
from tossid.evaluation.evaluate import Scores, metric_means, ranked
from tossid.models import TrainedModel, build_model, variant
from tossid.models.contactnets import ContactNets
from tossid.objects import ObjectModel, center_positions
from tossid.settings.training import ModelSettings, TrainSettings
from tossid.store import Dataset


def model_of(cube: ObjectModel, gravity: float = 9.81) -> TrainedModel:
    """The stated cube, as if it had been learned."""
    settings = TrainSettings(model=replace(variant("cn"), gravity=gravity))
    model = build_model(settings.model, cube)
    return TrainedModel(model, settings, model.parameters_report())


@pytest.fixture(scope="module")
def dataset(cube: ObjectModel) -> Dataset:
    made = tosses(cube, 5, seed=2, frames=60, substeps=ModelSettings.substeps)
    return Dataset(cube, tuple(made), 148.0, "made")


@pytest.fixture(scope="module")
def scores(cube: ObjectModel, dataset: Dataset) -> Scores:
    """Of a model with too little gravity."""
    return tossid.evaluate(model_of(cube, gravity=9.0), dataset)


def test_the_truth_has_no_error(cube: ObjectModel, dataset: Dataset) -> None:
    scores = tossid.evaluate(model_of(cube), dataset)
    for metrics in (scores.metrics, scores.metrics["from_flight"], scores.metrics["sixteen_steps"]):
        assert metrics["position_error_pct"]["mean"] < 0.5
        assert metrics["rotation_error_deg"]["mean"] < 0.5
    assert scores.metrics["gravity_ms2"]["mean"] == pytest.approx(9.81)
    assert scores.metrics["diverged"] == 0


def test_batches_give_what_all_at_once_gives(cube: ObjectModel, dataset: Dataset, scores: Scores) -> None:
    parts = tossid.evaluate(model_of(cube, gravity=9.0), dataset, batch=2)
    for name, value in vars(scores.per_toss).items():
        np.testing.assert_allclose(vars(parts.per_toss)[name], value, rtol=1e-9, atol=1e-9, err_msg=name)
    assert parts.names == tuple(toss.name for toss in dataset.tosses)


def test_the_rollouts_that_are_drawn_are_those_that_were_scored(
    cube: ObjectModel, dataset: Dataset, scores: Scores
) -> None:
    for toss, run, error in zip(dataset.tosses, scores.rollouts(), scores.per_toss.position_error_pct, strict=True):
        distance = np.linalg.norm(center_positions(cube, run.q) - center_positions(cube, toss.q), axis=1)
        assert 100 * distance.mean() / cube.width == pytest.approx(error, abs=1e-9)


def test_they_show_and_save_themselves(scores: Scores, tmp_path: Path) -> None:
    assert "position_error_pct" in repr(scores)
    assert scores._repr_html_().count("<tr>") == 1 + len(scores.table()[1])
    files = {path.name for path in scores.save(tmp_path / "scores")}
    assert {"metrics.json", "errors_over_tosses.png", "toss_comparison_worst.png", "toss_median.gif"} <= files
    found = json.loads((tmp_path / "scores" / "metrics.json").read_text())
    assert found == scores.as_json()
    assert found["n_tosses"] == 5
    means = metric_means(scores.metrics)
    assert means["from_flight/position_error_pct"] == found["from_flight"]["position_error_pct"]["mean"]
    assert means["diverged"] == 0


def test_the_median_and_the_worst_of_the_finite_errors_are_drawn(cube: ObjectModel, dataset: Dataset) -> None:
    assert ranked(np.array([3.0, np.inf, 1.0, 2.0])) == {"median": 3, "worst": 0}
    assert ranked(np.array([1.0, 2.0])) == {"median": 0, "worst": 1}
    assert ranked(np.array([np.nan, 5.0])) == {"median": 1}
    assert ranked(np.array([np.nan])) == {}
    single = tossid.evaluate(model_of(cube, gravity=0.0), replace(dataset, tosses=dataset.tosses[:1])).figures()
    assert "toss_comparison_median" in single
    assert not {"toss_comparison_worst", "geometry_at_angles"} & single.keys()
    assert "CN, given no gravity" in single["residual_over_toss"].texts[0].get_text()


# ---------------------------------------------------------------- as a file


@pytest.fixture(autouse=True)
def few_flights(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("tossid.evaluation.export.FLIGHTS", 4)
    monkeypatch.setattr("tossid.evaluation.export.FLIGHT_S", 0.1)


@pytest.mark.parametrize(("form", "suffix"), [("mjcf", ".xml"), ("urdf", ".urdf")])
def test_mujoco_flies_the_file_as_tossid_flies_the_model(
    cube: ObjectModel, tmp_path: Path, form: str, suffix: str
) -> None:
    found = tossid.export(model_of(cube), tmp_path / f"cube{suffix}", format=form)
    assert found.check["free_flight"].position_mm < 0.1
    assert found.check["free_flight"].rotation_deg < 0.05
    assert ("with_contact" in found.check) == (form == "mjcf")
    assert any("gravity" in text for text in found.left_out) == (form == "urdf")
    assert all(path.is_file() for path in found.files)
    assert "free flight" in found._repr_html_()


def test_gravity_of_k_res_is_carried_and_the_rest_of_it_named(cube: ObjectModel, tmp_path: Path) -> None:
    settings = TrainSettings(model=replace(variant("cnrp"), gravity=5.0))
    model = build_model(settings.model, cube)
    assert isinstance(model, ContactNets)
    with torch.no_grad():
        model.k_res.vertical -= 0.4  # 4 m/s² more downwards
        model.k_res.linear[0, 0] += 0.05
    found = tossid.export(TrainedModel(model, settings, {}), tmp_path / "cube.xml")
    assert found.gravity_ms2 == pytest.approx(9.0)
    scene = mujoco.MjModel.from_xml_path(str(tmp_path / "cube.xml"))
    assert scene.opt.gravity[2] == pytest.approx(-9.0)
    assert any("k_res" in text for text in found.left_out)
    assert found.check["free_flight_with_residual"].position_mm > 10 * found.check["free_flight"].position_mm


def test_contact_too_stiff_for_the_time_step_is_written_rigid(cube: ObjectModel, tmp_path: Path) -> None:
    stiff = cube.with_changes(compliance=(1e-4) ** 2 / float(cube.mass.sum()), relaxation=1e-4)
    found = tossid.export(model_of(stiff), tmp_path / "cube.xml")
    assert any("how contact gives way" in text for text in found.left_out)


def test_wrong_calls_are_refused_and_a_network_is_no_rigid_body(
    cube: ObjectModel, dataset: Dataset, tmp_path: Path
) -> None:
    settings = TrainSettings(model=variant("e2e"))
    network = TrainedModel(build_model(settings.model, cube), settings, {})
    assert tossid.evaluate(network, dataset).acceleration_figure() == {}
    with pytest.raises(InputError, match="no tosses"):
        tossid.evaluate(model_of(cube), replace(dataset, tosses=()))
    with pytest.raises(ConfigError, match=r"does not end in \.urdf"):
        tossid.export(model_of(cube), tmp_path / "cube.xml", format="urdf")
    with pytest.raises(InputError, match="holds no object"):
        tossid.export(network, tmp_path / "cube.xml")
    assert not list(tmp_path.iterdir())
