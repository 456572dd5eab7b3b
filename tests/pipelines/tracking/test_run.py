"""Runs in MLflow: readable by its own client in its default store, ended as they ended, found again."""

from __future__ import annotations

import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from pipelines.tracking.run import tracked_run
from pipelines.tracking.runs import find_run, find_runs
from tests.pipelines.stored import metric_history, stored_run
from tossid.yaml_files import read_yaml

SHA = "ab" * 32
pytestmark = pytest.mark.usefixtures("inside")


def test_a_run_with_all_it_has(store: Path) -> None:
    from mlflow import MlflowClient

    checkpoint = store / "checkpoint.pt"
    checkpoint.write_bytes(b"weights")
    figure = store / "curve.png"
    figure.write_bytes(b"a curve")
    with tracked_run("full", {"model": {"name": "cn", "width": None}, "seed": 3}, command="train") as run:
        run.data(Path("data.h5"), SHA, context="training")
        for step in range(1200):
            run.metrics({"loss": 1.0 / (step + 1), "validation": float(step)}, step=step)
        run.artifact(figure, folder="figures")
        run.checkpoint(checkpoint)

    client = MlflowClient(f"sqlite:///{store / 'mlflow.db'}")  # what `mlflow ui` reads here
    seen = client.get_run(run.id)
    assert seen.info.status == "FINISHED"
    assert seen.data.params == {"model.name": "cn", "model.width": "null", "seed": "3"}
    assert len(client.get_metric_history(run.id, "loss")) == 1200
    assert metric_history(run.id, "validation")[7] == (7, 7.0)
    assert seen.data.tags["tossid.command"] == "train"
    assert seen.data.tags["version.numpy"] == np.__version__
    assert seen.inputs is not None
    dataset = seen.inputs.dataset_inputs[0]
    assert str(store / "data.h5") in dataset.dataset.source
    assert SHA in dataset.dataset.source
    assert {item.path for item in client.list_artifacts(run.id)} == {"checkpoint.pt", "config.yaml", "figures"}

    record = find_run("full")
    assert record.id == run.id
    assert read_yaml(record.folder / "config.yaml") == {"model": {"name": "cn", "width": None}, "seed": 3}
    assert record.checkpoint is not None
    assert record.checkpoint.read_bytes() == b"weights"
    assert seen.data.metrics["loss"] == pytest.approx(1 / 1200)
    assert find_run(record.folder).checkpoint == record.checkpoint


def test_ends_as_it_ended() -> None:
    for error, status in ((ValueError, "FAILED"), (KeyboardInterrupt, "KILLED")):
        with pytest.raises(error), tracked_run(status, {}, command="ends") as run:
            run.metrics({"loss": 1.0})
            raise error
        (seen,) = find_runs(command="ends", tags={"mlflow.runName": status})
        assert seen.info.status == status
        assert seen.data.metrics == {"loss": 1.0}  # what was buffered is kept


def test_a_run_goes_on() -> None:
    with pytest.raises(KeyboardInterrupt), tracked_run("long", {"seed": 1}, command="long") as run:
        assert run.last_step() == 0
        run.metrics({"loss": 2.0}, step=3)
        raise KeyboardInterrupt
    assert find_runs(command="long")[0].info.status == "KILLED"
    with tracked_run("long", {"seed": 1}, command="long", resume=run.id) as again:
        assert (again.id, again.resumed, again.last_step()) == (run.id, True, 3)
        assert find_runs(command="long")[0].info.status == "RUNNING"
        again.metrics({"loss": 1.0}, step=4)
    assert metric_history(run.id, "loss") == [(3, 2.0), (4, 1.0)]
    assert stored_run(run.id).info.status == "FINISHED"


def test_a_run_that_this_store_does_not_have_is_begun_anew() -> None:
    with tracked_run("lost", {"seed": 1}, command="lost", resume="0" * 32) as run:
        assert not run.resumed
    assert find_run("lost", command="lost").id == run.id != "0" * 32


TWICE = """
import os, signal, sys, time
from pipelines.tracking import run as module
flush = module.TrackedRun.flush
def slow(self):
    if os.path.exists("cleaning"):
        return flush(self)
    open("cleaning", "w").close()
    time.sleep(2)  # the second one comes now
    flush(self)
with module.tracked_run("twice", {}, command="twice") as run:
    run.metrics({"loss": 1.0})
    module.TrackedRun.flush = slow
    print("ready", flush=True)
    time.sleep(60)
"""


def test_a_second_interruption_does_not_leave_the_run_running(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with subprocess.Popen(
        [sys.executable, "-c", TWICE], cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as running:
        assert running.stdout is not None
        assert running.stdout.readline() == "ready\n"
        running.send_signal(signal.SIGINT)
        while not (tmp_path / "cleaning").exists():
            time.sleep(0.05)
        running.send_signal(signal.SIGINT)
        _, err = running.communicate(timeout=60)
    assert "KeyboardInterrupt" in err
    monkeypatch.chdir(tmp_path)
    (seen,) = find_runs(command="twice")
    assert seen.info.status == "KILLED"
    assert seen.data.metrics == {"loss": 1.0}


WRITER = """
import sys
from pipelines.tracking.run import tracked_run
with tracked_run(sys.argv[1], {}, command="several") as run:
    for step in range(300):
        run.metrics({"a": step, "b": step}, step=step)
        if step % 50 == 0:
            run.flush()
"""


def test_several_processes_make_and_fill_one_store(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    writers = [
        subprocess.Popen([sys.executable, "-c", WRITER, f"w{i}"], cwd=tmp_path, stderr=subprocess.PIPE, text=True)
        for i in range(2)
    ]
    for writer in writers:
        _, err = writer.communicate(timeout=120)
        assert writer.returncode == 0, err
        assert err == ""  # no chatter
    monkeypatch.chdir(tmp_path)
    runs = find_runs(command="several")
    assert sorted(run.info.run_name for run in runs) == ["w0", "w1"]
    for run in runs:
        assert len(metric_history(run.info.run_id, "a")) == 300
