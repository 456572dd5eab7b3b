"""One tracking server for several people: nothing is lost when it goes away."""

from __future__ import annotations

import itertools
import runpy
import subprocess
import sys
from collections import Counter
from pathlib import Path
from typing import Any

import pytest
import yaml

from pipelines.cli import app
from pipelines.tracking.mlflow_store import client
from pipelines.tracking.runs import find_run, find_runs
from tests.conftest import ROOT
from tests.pipelines.conftest import metric_history, one_line, stored_run
from tests.pipelines.processes import Server, wait_for

SERVER = ROOT / "docs" / "server"
LOGGING = """
import sys, time
from pathlib import Path
from pipelines.tracking.run import tracked_run
name = sys.argv[1]
Path(f"{name}.txt").write_text("an artifact of " + name)
with tracked_run(name, {"seed": 1}, command="train") as run:
    for step in range(1, 1001):
        run.metrics({"loss": 1 / step}, step=step)
        if step % 50 == 0:
            run.flush()
            Path(f"{name}.step").write_text(str(step))
            time.sleep(float(sys.argv[2]))
    run.artifact(Path(f"{name}.txt"))
"""
TRAIN = ["train", "model=cn", "model.horizons=[]", "epochs=8", "patience=8", "data=tosses"]


def test_any_password_fits_into_the_databases_address() -> None:
    from sqlalchemy import make_url

    address = runpy.run_path(str(SERVER / "start.py"))["address"]
    for password in ("p@ss/w:rd%40#?", "ünïcode +&= ", "plain"):
        url = make_url(address(password))
        assert (url.password, url.username, url.host, url.port, url.database) == (
            password, "mlflow", "database", 5432, "mlflow"
        )  # fmt: skip


def test_the_containers_know_the_password_from_a_file_and_install_nothing_when_they_start() -> None:
    composed = yaml.safe_load((SERVER / "compose.yaml").read_text())
    database, mlflow = composed["services"]["database"], composed["services"]["mlflow"]
    assert database["environment"]["POSTGRES_PASSWORD_FILE"] == "/run/secrets/database"
    assert database["secrets"] == mlflow["secrets"] == ["database"]
    assert "command" not in mlflow
    assert not any("PASSWORD" in name for name in mlflow["environment"])
    lines = (SERVER / "Dockerfile").read_text().splitlines()
    (install,) = [line for line in lines if "pip install" in line]
    assert "--constraint /locks/cpu.txt" in install


@pytest.mark.slow
def test_runs_whose_server_is_started_again_in_the_middle(
    project: Path, tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch
) -> None:
    """4 runs of 1,000 points each; the server goes down and comes back: every point is there, once."""
    server = Server(tmp_path_factory.mktemp("server"))
    try:
        server.start()
        monkeypatch.setenv("MLFLOW_TRACKING_URI", server.uri)
        names = [f"run{i}" for i in range(4)]
        runs = [subprocess.Popen([sys.executable, "-c", LOGGING, name, "1"], cwd=project) for name in names]
        assert wait_for(lambda: sum(int(path.read_text() or 0) for path in project.glob("*.step")) >= 800, 300)
        server.stop()
        server.start()
        assert [run.wait(300) for run in runs] == [0] * len(names)
        for name in names:
            record = stored_run(find_run(name).id)
            assert record.info.status == "FINISHED"
            points = metric_history(record.info.run_id, "loss")
            assert Counter(step for step, _ in points) == Counter(range(1, 1001))
            files = {item.path for item in client().list_artifacts(record.info.run_id)}
            assert files == {"config.yaml", f"{name}.txt"}
    finally:
        server.stop()


def test_a_training_whose_server_is_lost_ends_and_goes_on_in_its_run(
    beside: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str], answer: Any
) -> None:
    from mlflow import MlflowClient
    from mlflow.exceptions import MlflowException

    log, batches = MlflowClient.log_batch, itertools.count()

    def lost(*args: Any, **more: Any) -> None:
        if next(batches) > 2:
            raise MlflowException("API request to http://ann:secret@lab:5000 failed: Connection refused")
        log(*args, **more)

    monkeypatch.setattr("pipelines.tracking.run._BUFFER", 20)
    with monkeypatch.context() as patch:
        patch.setattr(MlflowClient, "log_batch", lost)
        assert app.run([*TRAIN, "--quiet"]) == 1
    said = one_line(capfd.readouterr().err)
    assert "Connection refused" in said
    assert "can be run again" in said
    assert "secret" not in said
    left = find_runs(command="train")[0].info
    assert left.status == "FAILED"
    assert answer(*TRAIN)["run"] == left.run_id
    assert stored_run(left.run_id).info.status == "FINISHED"
    steps = [step for step, _ in metric_history(left.run_id, "contact/train")]
    assert steps == list(range(1, len(steps) + 1))
    assert len(steps) > 3
