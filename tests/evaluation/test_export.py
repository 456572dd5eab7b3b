"""`tossid.export`: MuJoCo moves the file as tossid moves the model, and what a file cannot carry is named."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import mujoco
import pytest
import torch

import tossid
from tests.evaluation.test_evaluate import model_of
from tossid.errors import ConfigError, InputError
from tossid.models import TrainedModel, build_model, variant
from tossid.models.contactnets import ContactNets
from tossid.objects import ObjectModel
from tossid.settings.training import TrainSettings


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
    assert model.k_res is not None
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


def test_wrong_calls_are_refused(cube: ObjectModel, tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"does not end in \.urdf"):
        tossid.export(model_of(cube), tmp_path / "cube.xml", format="urdf")
    settings = TrainSettings(model=variant("e2e"))
    network = TrainedModel(build_model(settings.model, cube), settings, {})
    with pytest.raises(InputError, match="holds no object"):
        tossid.export(network, tmp_path / "cube.xml")
    assert not list(tmp_path.iterdir())
