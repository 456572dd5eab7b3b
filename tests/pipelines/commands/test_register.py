"""A model in the registry is the run's, with a signature, and MLflow can load it without us."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pipelines.cli import app
from pipelines.tracking.runs import find_run
from tests.pipelines.conftest import one_line
from tossid import TrainedModel


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
