"""One tracking server for several people: nothing that is logged is lost while it is away."""

from __future__ import annotations

import json
import subprocess
import sys
import time
from collections import Counter
from pathlib import Path
from typing import Any

import pytest

from pipelines.outbox import UNSENT, Outbox, send_unsent, unsent_runs
from tests.pipelines.cluster import wait_for
from tests.pipelines.served import Server, postgres

LOGGING = """
import sys, time
from pathlib import Path
from pipelines.tracking import tracked_run
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


class Recorder:
    """A client that notes what it is told, or that nobody answers."""

    def __init__(self) -> None:
        self.told: list[Any] = []
        self.away = False

    def __getattr__(self, name: str) -> Any:
        def call(run: str, *args: Any, **more: Any) -> None:
            from mlflow.exceptions import MlflowException

            if self.away:
                raise MlflowException("API request failed with exception Connection refused")
            if name == "log_artifact":
                args = (Path(args[0]).read_text(), *args[1:])
            if "metrics" in more:
                args = tuple(point.step for point in more["metrics"])
            self.told.append((name, *args))

        return call


def test_what_waits_is_told_later_in_order_and_survives_its_process(project: Path) -> None:
    client: Any = Recorder()
    box = Outbox(client, "r1", remote=True)
    box.tell("tag", "a", "1")
    client.away = True
    (project / "note.txt").write_text("first")
    box.tell("metrics", [["loss", 0.5, 7, 1]])
    box.tell("artifact", "note.txt", None)
    (project / "note.txt").write_text("changed since")
    box.tell("metrics", [["loss", 0.4, 8, 2]])
    assert (box.waiting(), client.told) == (3, [("set_tag", "a", "1")])
    assert unsent_runs() == [UNSENT / "r1"]

    send_unsent(client)  # the next command, in vain
    assert box.waiting() == 3
    client.away = False
    send_unsent(client)
    assert client.told[1:] == [("log_batch", 1), ("log_artifact", "first", None), ("log_batch", 2)]
    assert unsent_runs() == []
    assert list(UNSENT.glob("*")) == []


def test_what_a_server_refuses_is_an_error(project: Path) -> None:
    from mlflow.exceptions import MlflowException

    class Refusing:
        def set_tag(self, *_: Any) -> None:
            raise MlflowException.invalid_parameter_value("no such run")

    client: Any = Refusing()
    with pytest.raises(MlflowException, match="no such run"):
        Outbox(client, "r1", remote=True).tell("tag", "a", "1")
    assert unsent_runs() == []


def test_a_store_of_files_is_never_away(project: Path) -> None:
    from mlflow.exceptions import MlflowException

    client: Any = Recorder()
    client.away = True
    with pytest.raises(MlflowException):
        Outbox(client, "r1", remote=False).tell("tag", "a", "1")


def test_no_server_at_the_start(project: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    script = "from pipelines.app import main; main(['evaluate'])"
    monkeypatch.setenv("MLFLOW_TRACKING_URI", "http://127.0.0.1:9")
    monkeypatch.setenv("MLFLOW_HTTP_REQUEST_MAX_RETRIES", "0")
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, cwd=project, timeout=120)
    assert done.returncode == 2
    assert "MLFLOW_TRACKING_URI=http://127.0.0.1:9: the tracking server does not answer" in done.stderr


@pytest.mark.slow
def test_eight_runs_and_a_server_that_is_stopped_in_the_middle(
    project: Path, tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch
) -> None:
    """8 runs of 1,000 points each on PostgreSQL; the server goes down and comes back: every point is there, once."""
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
            assert wait_for(lambda: len(unsent_runs()) == 8, 120), "every run was to miss the server"
            waited = sum(len(list(folder.glob("*.json"))) for folder in unsent_runs())
            began = time.monotonic()
            server.start()
            assert [run.wait(300) for run in runs] == [0] * 8
            from mlflow.artifacts import download_artifacts

            from pipelines.runs import find_run, metric_history
            from pipelines.tracking import tracked_run

            with tracked_run("the next", {}, command="other"):
                pass
            assert unsent_runs() == []
            for name in names:
                record = find_run(name)
                assert record.status == "FINISHED"
                steps = Counter(step for step, _ in metric_history(record.id, "loss"))
                assert steps == Counter(range(1, 1001))
                text = download_artifacts(run_id=record.id, artifact_path=f"{name}.txt")
                assert Path(text).read_text() == f"an artifact of {name}"
            print(json.dumps({"waited": waited, "seconds after the start": round(time.monotonic() - began)}))
        finally:
            server.stop()
