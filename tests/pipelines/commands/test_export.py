"""Learned models outside: as MJCF and URDF, and in the registry of MLflow."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import mlflow
import mujoco
import numpy as np
import pytest

from pipelines.cli import app
from pipelines.tracking.runs import find_run
from tests.pipelines.conftest import one_line
from tossid import TrainedModel
from tossid.objects import load_object


def test_a_run_is_exported_as_far_as_the_format_goes(beside: Path, answer: Any) -> None:
    found = answer("export", "format=urdf", "out=here/cube.urdf")
    assert found["check"]["free_flight"]["position_mm"] < 1.0
    assert all(any(word in text for text in found["left_out"]) for word in ("k_res", "gravity"))
    assert {Path(file).name for file in found["files"]} == {"cube.urdf", "cube_cube.obj"}
    assert load_object(beside / "here/cube.urdf").n_corners == 8
    scene = answer("export", "out=here/cube.xml")
    gravity = mujoco.MjModel.from_xml_path(str(beside / "here/cube.xml")).opt.gravity[2]
    assert gravity == pytest.approx(-scene["gravity_ms2"], abs=1e-4)


def test_registered_evaluated_and_loaded_by_mlflow(
    beside: Path, answer: Any, capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    first = find_run()
    other = answer("train", "model=cn", "epochs=1", "data=tosses")["run"]
    made = answer("register", "name=cube", f"run={first.id}")
    assert (made["version"], made["model"]) == (1, "models:/cube/1")
    assert answer("register", "name=cube")["version"] == 2
    assert (find_run("models:/cube/1").id, find_run("models:/cube/latest").id) == (first.id, other)
    assert app.run(["evaluate", "run=models:/cube/3"]) == 2
    assert "run=models:/cube/3: no such model; versions of 'cube': 1, 2" in one_line(capfd.readouterr().err)
    assert app.run(["evaluate", "run=models:/cube"]) == 2
    assert "expected models:/NAME/VERSION" in one_line(capfd.readouterr().err)

    mlflow.set_tracking_uri(f"sqlite:///{beside / 'mlflow.db'}")
    try:
        loaded = mlflow.pyfunc.load_model("models:/cube/1")
    finally:
        mlflow.set_tracking_uri(None)
    q, v = np.array([[0, 0, 1.0, 1, 0, 0, 0]]), np.array([[1.0, 0, 0, 0, 0, 0]])
    motion = loaded.predict({"q": q, "v": v}, params={"n_steps": 10, "dt": 0.01})
    assert first.checkpoint is not None
    here = TrainedModel.load(first.checkpoint).model.simulator().rollout(q, v, n_steps=10, dt=0.01)
    assert np.array_equal(motion["q"], here.q)
    with pytest.raises(Exception, match=r"(?i)schema|shape"):
        loaded.predict({"q": q[:, :3], "v": v})
    assert not [path for path in (beside / "mlruns").rglob("*") if path.suffix in (".pkl", ".pickle")]

    # what a stranger writes into the model's `MLmodel` is not imported, only the weights are read
    (beside / "hostile.py").write_text("from pathlib import Path\nPath('ran').touch()\ndef _load_pyfunc(path): pass\n")
    monkeypatch.syspath_prepend(str(beside))
    for path in beside.rglob("MLmodel"):
        path.write_text(path.read_text().replace("pipelines.tracking.registry", "hostile"))
        assert "hostile" in path.read_text()
    assert answer("evaluate", "run=models:/cube/1")["run"] == first.id
    assert not (beside / "ran").exists()
