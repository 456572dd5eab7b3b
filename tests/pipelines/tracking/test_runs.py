"""Runs are found again: the newest, by id, by name, by folder, by tag, under a parent."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from pipelines.tracking.run import tracked_run
from pipelines.tracking.runs import find_run, find_runs
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
