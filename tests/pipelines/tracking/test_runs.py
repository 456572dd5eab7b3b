"""Runs in MLflow: whole, ended as they ended, and found again by id, name, folder, tag or parent."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from pipelines.tracking.mlflow_store import client
from pipelines.tracking.run import tracked_run
from pipelines.tracking.runs import CHECKPOINT, EXPERIMENT, RUN, TRAININGS, find_run, find_runs
from tests.pipelines.conftest import metric_history, one_line, stored_run
from tossid.errors import InputError
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
        (seen,) = [found for found in find_runs(command="ends") if found.info.run_name == status]
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


pytestmark = pytest.mark.usefixtures("inside")


def test_nested_runs() -> None:
    with tracked_run("study", {}, command="study") as parent:
        for value in (1, 2):
            with tracked_run(
                f"cell {value}", {"gravity": value}, command="cell", parent=parent, tags={"cell": str(value)}
            ):
                pass
    assert [run.info.run_name for run in find_runs(parent=parent.id)] == ["cell 2", "cell 1"]
    assert [run.data.tags["cell"] for run in find_runs(parent=parent.id)] == ["2", "1"]
    assert find_runs(command="cell") == []
    assert stored_run(find_run("cell 1", command="cell").id).data.params == {"gravity": "1"}


def test_newest_finished_run_is_found() -> None:
    with tracked_run("first", {}, command="newest"):
        pass
    with tracked_run("second", {}, command="newest") as second:
        pass
    with pytest.raises(ValueError, match="no"), tracked_run("third", {}, command="newest"):
        raise ValueError("no")
    assert find_run(command="newest").id == second.id
    assert find_run(second.id[:8], command="newest").name == "second"
    assert find_run(second.id, command="newest").name == "second"
    with pytest.raises(InputError, match=r"no such run.*second"):
        find_run("forth", command="newest")


LOOK_UP = """
import sys
from pathlib import Path
from types import SimpleNamespace
from pipelines.tracking import runs

class Store:
    def list_artifacts(self, run):
        return [SimpleNamespace(path=name) for name in ("checkpoint.pt", "config.yaml", "figures")]
    def download_artifacts(self, run, name, folder):
        (Path(folder) / name).write_text("seed: 1")

runs.client = Store
info = SimpleNamespace(run_id="1", run_name="far", status="FINISHED", artifact_uri="mlflow-artifacts:/1/1/artifacts")
run = SimpleNamespace(info=info)
for _ in range(3):
    found = runs.record_of(run)
    print(found.checkpoint.read_text(), sorted(path.name for path in found.folder.iterdir()))
"""


def test_look_ups_of_remote_runs_leave_no_copies(tmp_path: Path) -> None:
    environment = os.environ | {"TMPDIR": str(tmp_path)}
    done = subprocess.run([sys.executable, "-c", LOOK_UP], env=environment, capture_output=True, text=True, timeout=60)
    assert done.stdout.splitlines() == ["seed: 1 ['checkpoint.pt']"] * 3, done.stderr
    assert list(tmp_path.iterdir()) == []


def _checkpointed(name: str, command: str) -> str:
    with tracked_run(name, {}, command=command) as run:
        Path(CHECKPOINT).write_bytes(b"weights")
        run.checkpoint(Path(CHECKPOINT))
    return run.id


@pytest.mark.parametrize("first", ["find", "track", "resume"])
def test_an_experiment_deleted_in_the_page_is_restored_with_its_runs(
    first: str, capfd: pytest.CaptureFixture[str]
) -> None:
    known, store = _checkpointed("kept", f"{first}-deleted"), client()
    store.delete_experiment(store.get_experiment_by_name(EXPERIMENT).experiment_id)
    if first != "find":
        left = known if first == "resume" else None
        with tracked_run("next", {}, command="next", resume=left) as run:
            assert run.resumed == (first == "resume")
    assert find_run("kept", command=f"{first}-deleted").weights().read_bytes() == b"weights"
    said = one_line(capfd.readouterr().err)
    assert "experiment 'tossid' had been deleted in MLflow; it is restored, with all of its runs" in said


def test_an_experiment_that_is_gone_for_good_is_made_anew() -> None:
    from mlflow.entities import ViewType

    _checkpointed("old", "train")
    store = client()
    old = store.get_experiment_by_name(EXPERIMENT).experiment_id
    store.delete_experiment(old)
    tracking = store._tracking_client.store
    for run in store.search_runs([old], run_view_type=ViewType.ALL):
        tracking._hard_delete_run(run.info.run_id)
    tracking._hard_delete_experiment(old)  # (what `mlflow gc` does)
    with pytest.raises(InputError, match="no finished run yet"):
        find_run()
    assert store.get_experiment_by_name(EXPERIMENT) is None
    assert find_run(_checkpointed("new", "train")).name == "new"


def test_a_deleted_run_is_named_with_what_brings_it_back() -> None:
    known = _checkpointed("thrown-away", "deleted")
    client().delete_run(known)
    back = f"run thrown-away was deleted in MLflow; 'mlflow runs restore --run-id {known}' brings it back"
    for reference in (known, known[:8], "thrown-away"):
        with pytest.raises(InputError, match=f"run={reference}: {back}"):
            find_run(reference, command="deleted")
    with pytest.raises(InputError, match=rf"no finished run \({back}\); make one with 'tossid deleted'"):
        find_run(command="deleted")
    with tracked_run("left", {}, command="deleted", resume=known) as run:
        assert not run.resumed
    client().restore_run(known)
    assert find_run("thrown-away", command="deleted").id == known


def test_files_of_a_run_that_are_gone_are_named_with_a_copy() -> None:
    lost, kept = (find_run(_checkpointed(name, "files"), command="files") for name in ("lost", "copied"))
    for record in (lost, kept):
        shutil.rmtree(record.folder)
    copy = TRAININGS / "cn-0123"
    copy.mkdir(parents=True)
    (copy / CHECKPOINT).write_bytes(b"weights")
    (copy / RUN).write_text(json.dumps({"run": kept.id}))
    with pytest.raises(InputError, match=rf"lost its files, there is no folder {lost.folder}; run=NAME names another"):
        find_run(lost.id, command="files").weights()
    with pytest.raises(InputError, match=r"; run=outputs/train/cn-0123 is the same training"):
        find_run(kept.id, command="files").weights()
    assert find_run(copy).weights() == copy / CHECKPOINT


def test_a_registered_model_whose_run_was_purged() -> None:
    known, store = find_run(_checkpointed("registered", "kept"), command="kept"), client()
    store.create_registered_model("cube")
    store.create_model_version("cube", str(known.folder), run_id=known.id)
    assert find_run("models:/cube/1").id == known.id
    store.delete_run(known.id)
    assert find_run("models:/cube/1").weights().is_file()  # what is in the bin still has its files
    store._tracking_client.store._hard_delete_run(known.id)
    with pytest.raises(InputError, match=r"run=models:/cube/1: the run that it was made from is not in MLflow"):
        find_run("models:/cube/1")
    store.delete_registered_model("cube")
    with pytest.raises(InputError, match="no such model; versions of 'cube': none"):
        find_run("models:/cube/latest")
