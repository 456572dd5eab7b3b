"""One tracking server for several people: nothing that is logged is lost when it goes away."""

from __future__ import annotations

import subprocess
import sys
from collections import Counter
from pathlib import Path

import pytest
import yaml
from mlflow import MlflowClient

from pipelines.tracking import run as run_module
from pipelines.tracking.mlflow_store import client
from pipelines.tracking.runs import find_run
from tests.pipelines.conftest import metric_history, one_line, stored_run
from tests.pipelines.processes import Server, address, postgres, wait_for

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


def test_any_password_fits_into_the_databases_address() -> None:
    from sqlalchemy import make_url

    for password in ("p@ss/w:rd%40#?", "ünïcode +&= ", "plain"):
        url = make_url(address(password))
        assert (url.password, url.username, url.host, url.port, url.database) == (
            password, "mlflow", "database", 5432, "mlflow"
        )  # fmt: skip


def test_the_containers_know_the_password_from_a_file_and_install_nothing_when_they_start() -> None:
    folder = Path(__file__).parents[3] / "docs" / "server"
    composed = yaml.safe_load((folder / "compose.yaml").read_text())
    database, mlflow = composed["services"]["database"], composed["services"]["mlflow"]
    assert database["environment"]["POSTGRES_PASSWORD_FILE"] == "/run/secrets/database"
    assert database["secrets"] == mlflow["secrets"] == ["database"]
    assert "command" not in mlflow
    assert not any("PASSWORD" in name for name in mlflow["environment"])
    lines = (folder / "Dockerfile").read_text().splitlines()
    (install,) = [line for line in lines if "pip install" in line]
    assert "--constraint /locks/cpu.txt" in install


@pytest.mark.slow
def test_eight_runs_and_a_server_that_is_stopped_in_the_middle(
    project: Path, tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch
) -> None:
    """8 runs of 1,000 points each on PostgreSQL; the server goes down: every point of each is here, once."""
    place = tmp_path_factory.mktemp("server")
    with postgres() as database:
        server = Server(place, database)
        try:
            server.start()
            monkeypatch.setenv("MLFLOW_TRACKING_URI", server.uri)
            names = [f"run{i}" for i in range(8)]
            runs = [subprocess.Popen([sys.executable, "-c", LOGGING, name, "2"], cwd=project) for name in names]
            assert wait_for(lambda: sum(int(path.read_text() or 0) for path in project.glob("*.step")) >= 1600, 300)
            server.stop()
            assert [run.wait(300) for run in runs] == [0] * 8
        finally:
            server.stop()
    monkeypatch.delenv("MLFLOW_TRACKING_URI")
    for name in names:
        record = find_run(name)
        assert stored_run(record.id).info.status == "FINISHED"
        assert Counter(step for step, _ in metric_history(record.id, "loss")) == Counter(range(1, 1001))
        assert (record.folder / f"{name}.txt").read_text() == f"an artifact of {name}"


def test_a_run_whose_server_is_lost_is_whole_in_this_folders_store(
    project: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    """A stand-in for a server: a store that says it is one, and takes nothing after the first flush."""
    from mlflow.exceptions import MlflowException

    server, taken = client(), []
    monkeypatch.setattr(run_module, "client", lambda: server)
    monkeypatch.setattr(run_module, "is_remote", lambda store: store is server)
    local = MlflowClient("sqlite:///here.db")
    monkeypatch.setattr(run_module, "local_client", lambda: local)
    (project / "note.txt").write_text("a note")
    with run_module.tracked_run("cut", {"seed": 1}, command="train", tags={"kind": "lost"}) as run:
        run.metrics({"loss": 1.0}, step=1)
        run.artifact(project / "note.txt")
        run.flush()
        taken.append(run.id)

        def lost(*_: object, **__: object) -> None:
            raise MlflowException("API request to http://ann:secret@lab:5000 failed: Connection refused")

        for name in ("log_batch", "set_tag", "set_terminated"):
            monkeypatch.setattr(server, name, lost)
        run.metrics({"loss": 0.5}, step=2)
        run.tag("verdict", "whole")
    assert run.id != taken[0]
    found = local.get_run(run.id)
    assert (found.info.status, found.info.run_name) == ("FINISHED", "cut")
    assert found.data.params == {"seed": "1"}
    assert {"kind": "lost", "verdict": "whole", "tossid.command": "train"}.items() <= found.data.tags.items()
    assert [(p.step, p.value) for p in local.get_metric_history(run.id, "loss")] == [(1, 1.0), (2, 0.5)]
    assert {item.path for item in local.list_artifacts(run.id)} == {"config.yaml", "note.txt"}
    said = one_line(capfd.readouterr().err)
    assert "export-run" in said
    assert run.id in said
    assert "secret" not in said
