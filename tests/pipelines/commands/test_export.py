"""Learned models outside: as MJCF and URDF, and in the registry of MLflow."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest

from pipelines.cli import app
from pipelines.tracking.runs import find_run
from tests.pipelines.conftest import one_line
from tossid import TrainedModel
from tossid.objects import load_object


@pytest.mark.parametrize(("form", "suffix"), [("mjcf", ".xml"), ("urdf", ".urdf")])
def test_a_run_s_export_flies_as_tossid_has_it(beside: Path, answer: Any, form: str, suffix: str) -> None:
    found = answer("export", f"format={form}", f"out=here/cube{suffix}")
    assert found["check"]["free_flight"]["position_mm"] < 1.0
    assert found["check"]["free_flight"]["rotation_deg"] < 0.5
    assert ("with_contact" in found["check"]) == (form == "mjcf")
    assert any("k_res" in text for text in found["left_out"])
    assert any("gravity" in text for text in found["left_out"]) == (form == "urdf")
    again = load_object(beside / f"here/cube{suffix}") if form == "urdf" else None
    if again is not None:
        assert again.n_corners == 8
        assert {Path(file).name for file in found["files"]} == {"cube.urdf", "cube_cube.obj"}
    else:
        scene = mujoco.MjModel.from_xml_path(str(beside / "here/cube.xml"))
        np.testing.assert_allclose(scene.opt.gravity[2], -found["gravity_ms2"], atol=1e-4)


def test_a_name_that_is_not_the_format_s_is_refused(beside: Path, capfd: pytest.CaptureFixture[str]) -> None:
    assert app.run(["export", "format=urdf", "out=cube.xml"]) == 2
    assert "does not end in .urdf" in one_line(capfd.readouterr().err)


def test_a_registered_model_is_evaluated_by_its_weights_alone(
    beside: Path, answer: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What a stranger writes into the model's `MLmodel` is not imported, only the weights are read."""
    first = answer("train", "model=cn", "epochs=1", "data=tosses")
    answer("register", "name=cube", f"run={first['run']}")
    (beside / "hostile.py").write_text("from pathlib import Path\nPath('ran').touch()\ndef _load_pyfunc(path): pass\n")
    monkeypatch.syspath_prepend(str(beside))
    for path in beside.rglob("MLmodel"):
        path.write_text(path.read_text().replace("pipelines.tracking.registry", "hostile"))
        assert "hostile" in path.read_text()
    assert answer("evaluate", "run=models:/cube/1")["run"] == first["run"]
    assert not (beside / "ran").exists()


def test_registered_evaluated_and_loaded_by_mlflow(
    beside: Path, answer: Any, capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    first = answer("train", "model=cn", "epochs=1", "data=tosses")
    answer("train", "model=cn", "model.gravity=9.0", "epochs=1", "data=tosses")
    made = answer("register", "name=cube", f"run={first['run']}")
    assert (made["version"], made["model"]) == (1, "models:/cube/1")
    assert answer("register", "name=cube")["version"] == 2
    assert find_run("models:/cube/1").id == first["run"]
    assert find_run("models:/cube/latest").id != first["run"]
    judged = answer("evaluate", "run=models:/cube/1")
    assert judged["run"] == first["run"]

    assert app.run(["evaluate", "run=models:/cube/3"]) == 2
    assert "run=models:/cube/3: no such model; versions of 'cube': 1, 2" in one_line(capfd.readouterr().err)
    assert app.run(["evaluate", "run=models:/cube"]) == 2
    assert "expected models:/NAME/VERSION" in one_line(capfd.readouterr().err)

    import mlflow

    mlflow.set_tracking_uri(f"sqlite:///{beside / 'mlflow.db'}")
    try:
        loaded = mlflow.pyfunc.load_model("models:/cube/1")
    finally:
        mlflow.set_tracking_uri(None)
    signature = loaded.metadata.signature
    assert [(spec.name, spec.shape) for spec in signature.inputs.inputs] == [("q", (-1, 7)), ("v", (-1, 6))]
    q, v = np.array([[0, 0, 1.0, 1, 0, 0, 0]]), np.array([[1.0, 0, 0, 0, 0, 0]])
    motion = loaded.predict({"q": q, "v": v}, params={"n_steps": 10, "dt": 0.01})
    here = TrainedModel.load(Path(first["checkpoint"])).model.simulator().rollout(q, v, n_steps=10, dt=0.01)
    assert np.array_equal(motion["q"], here.q)
    assert motion["q"][0, -1, 0] == pytest.approx(0.1)
    with pytest.raises(Exception, match=r"(?i)schema|shape"):
        loaded.predict({"q": q[:, :3], "v": v})
    assert not [path for path in (beside / "mlruns").rglob("*") if path.suffix in (".pkl", ".pickle")]
