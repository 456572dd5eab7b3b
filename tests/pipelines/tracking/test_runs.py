"""Runs in MLflow: whole, ended as they ended, and found again by id, name, folder, tag or parent."""

from __future__ import annotations

import shutil
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pipelines.tracking.mlflow_store import client
from pipelines.tracking.run import TrackedRun, tracked_run
from pipelines.tracking.runs import CHECKPOINT, EXPERIMENT, find_run, find_runs
from tests.pipelines.conftest import metric_history, one_line, stored_run
from tossid.errors import InputError
from tossid.yaml_files import read_yaml

SHA = "ab" * 32
pytestmark = pytest.mark.usefixtures("inside")


def test_a_run_with_all_it_has(store: Path) -> None:
    from mlflow import MlflowClient

    for name in ("checkpoint.pt", "curve.png"):
        (store / name).write_bytes(name.encode())
    with tracked_run("full", {"model": {"name": "cn", "width": None}, "seed": 3}, command="train") as run:
        run.data(Path("data.h5"), SHA, context="training")
        for step in range(1200):
            run.metrics({"loss": 1.0 / (step + 1), "validation": float(step)}, step=step)
        run.artifact(store / "curve.png", folder="figures")
        run.artifact(store / "checkpoint.pt")

    client = MlflowClient(f"sqlite:///{store / 'mlflow.db'}")  # what `mlflow ui` reads here
    seen = client.get_run(run.id)
    assert seen.info.status == "FINISHED"
    assert seen.data.params == {"model.name": "cn", "model.width": "null", "seed": "3"}
    assert seen.data.metrics["loss"] == pytest.approx(1 / 1200)
    assert len(client.get_metric_history(run.id, "loss")) == 1200
    assert metric_history(run.id, "validation")[7] == (7, 7.0)
    assert seen.data.tags["tossid.command"] == "train"
    assert seen.data.tags["version.numpy"] == np.__version__
    source = seen.inputs.dataset_inputs[0].dataset.source
    assert str(store / "data.h5") in source
    assert SHA in source
    assert {item.path for item in client.list_artifacts(run.id)} == {"checkpoint.pt", "config.yaml", "figures"}

    record = find_run("full")
    assert record.id == run.id
    assert read_yaml(record.folder / "config.yaml") == {"model": {"name": "cn", "width": None}, "seed": 3}
    assert record.weights().read_bytes() == b"checkpoint.pt"
    assert find_run(record.folder).checkpoint == record.checkpoint


@pytest.mark.parametrize(("error", "status"), [(ValueError, "FAILED"), (KeyboardInterrupt, "KILLED")])
def test_a_run_ends_as_it_ended_and_goes_on(error: type[BaseException], status: str) -> None:
    with pytest.raises(error), tracked_run("long", {"seed": 1}, command=status) as run:
        assert run.last_step() == 0
        run.metrics({"loss": 2.0}, step=3)
        raise error
    (seen,) = find_runs(command=status)
    assert seen.info.status == status
    assert seen.data.metrics == {"loss": 2.0}  # what was buffered is kept
    with tracked_run("long", {"seed": 1}, command=status, resume=run.id) as again:
        assert (again.id, again.resumed, again.last_step()) == (run.id, True, 3)
        assert find_runs(command=status)[0].info.status == "RUNNING"
        again.metrics({"loss": 1.0}, step=4)
    assert metric_history(run.id, "loss") == [(3, 2.0), (4, 1.0)]
    assert stored_run(run.id).info.status == "FINISHED"


def test_a_run_that_this_store_does_not_have_is_begun_anew() -> None:
    with tracked_run("lost", {"seed": 1}, command="lost", resume="0" * 32) as run:
        assert not run.resumed
    assert find_run("lost", command="lost").id == run.id != "0" * 32


def test_a_second_interruption_does_not_leave_the_run_running(monkeypatch: pytest.MonkeyPatch) -> None:
    flush = TrackedRun.flush

    def interrupted_again(run: TrackedRun) -> None:
        signal.raise_signal(signal.SIGINT)
        flush(run)

    with pytest.raises(KeyboardInterrupt), tracked_run("twice", {}, command="twice") as run:
        run.metrics({"loss": 1.0})
        monkeypatch.setattr(TrackedRun, "flush", interrupted_again)
        raise KeyboardInterrupt
    seen = stored_run(run.id)
    assert seen.info.status == "KILLED"
    assert seen.data.metrics == {"loss": 1.0}


WRITER = """
import sys
from pipelines.tracking.run import tracked_run
with tracked_run(sys.argv[1], {}, command="several") as run:
    for step in range(100):
        run.metrics({"a": step, "b": step}, step=step)
        if step % 10 == 0:
            run.flush()
"""


def test_several_processes_make_and_fill_one_store(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    command = [sys.executable, "-c", WRITER]
    writers = [subprocess.Popen([*command, name], stderr=subprocess.PIPE, text=True) for name in ("w0", "w1")]
    for writer in writers:
        _, err = writer.communicate(timeout=120)
        assert (writer.returncode, err) == (0, "")  # no chatter
    runs = find_runs(command="several")
    assert sorted(run.info.run_name for run in runs) == ["w0", "w1"]
    for run in runs:
        assert len(metric_history(run.info.run_id, "a")) == 100


def test_nested_runs() -> None:
    with tracked_run("study", {}, command="study") as parent:
        for value in (1, 2):
            tags = {"cell": str(value)}
            with tracked_run(f"cell {value}", {"gravity": value}, command="cell", parent=parent, tags=tags):
                pass
    nested = find_runs(parent=parent.id)
    assert [(run.info.run_name, run.data.tags["cell"]) for run in nested] == [("cell 2", "2"), ("cell 1", "1")]
    assert find_runs(command="cell") == []
    assert stored_run(find_run("cell 1", command="cell").id).data.params == {"gravity": "1"}


def test_newest_finished_run_is_found() -> None:
    for name in ("first", "second"):
        with tracked_run(name, {}, command="newest") as second:
            pass
    with pytest.raises(ValueError, match="no"), tracked_run("third", {}, command="newest"):
        raise ValueError("no")
    assert find_run(command="newest").id == second.id
    for reference in (second.id[:8], second.id):
        assert find_run(reference, command="newest").name == "second"
    with pytest.raises(InputError, match=r"no such run.*second"):
        find_run("forth", command="newest")


def _checkpointed(name: str, command: str) -> str:
    with tracked_run(name, {}, command=command) as run:
        Path(CHECKPOINT).write_bytes(b"weights")
        run.artifact(Path(CHECKPOINT))
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


def test_what_was_deleted_in_the_page_is_named_with_what_brings_it_back() -> None:
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
    shutil.rmtree(find_run(known, command="deleted").folder)
    with pytest.raises(InputError, match=r"lost its files, there is no folder .*; run=NAME names another"):
        find_run(known, command="deleted").weights()


def test_a_registered_model_leads_to_its_run_until_that_is_purged() -> None:
    store: Any = client()
    known = find_run(_checkpointed("registered", "kept"), command="kept")
    store.create_registered_model("cube")
    store.create_model_version("cube", str(known.folder), run_id=known.id)
    store.set_registered_model_alias("cube", "champion", "1")
    for reference in ("models:/cube/1", "models:/cube/latest", "models:/cube@champion"):
        assert find_run(reference).id == known.id
    store.delete_run(known.id)
    assert find_run("models:/cube/1").weights().is_file()  # what is in the bin still has its files
    store._tracking_client.store._hard_delete_run(known.id)
    with pytest.raises(InputError, match=r"run=models:/cube/1: the run that it was made from is not in MLflow"):
        find_run("models:/cube/1")
    store.delete_registered_model("cube")
    with pytest.raises(InputError, match="no such model; versions of 'cube': none"):
        find_run("models:/cube/latest")
