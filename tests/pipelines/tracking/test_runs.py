"""Runs are found again: the newest, by id, by name, by folder, by tag, under a parent."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from pipelines.tracking.mlflow_store import client
from pipelines.tracking.run import tracked_run
from pipelines.tracking.runs import CHECKPOINT, EXPERIMENT, RUN, TRAININGS, find_run, find_runs
from tests.pipelines.conftest import one_line
from tests.pipelines.stored import stored_run
from tossid.errors import FileError, InputError

pytestmark = pytest.mark.usefixtures("inside")


def test_nested_runs() -> None:
    with tracked_run("study", {}, command="study") as parent:
        for value in (1, 2):
            with tracked_run(
                f"cell {value}", {"gravity": value}, command="cell", parent=parent, tags={"cell": str(value)}
            ):
                pass
    assert [run.info.run_name for run in find_runs(parent=parent.id)] == ["cell 2", "cell 1"]
    assert [run.data.params["gravity"] for run in find_runs(parent=parent.id, tags={"cell": "1"})] == ["1"]
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


def test_a_folder_that_is_no_run(tmp_path: Path) -> None:
    with pytest.raises(FileError, match="is no run"):
        find_run(tmp_path)


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
