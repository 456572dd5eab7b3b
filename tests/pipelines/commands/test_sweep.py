"""Studies: every cell is what train and evaluate give, is computed once, and survives what ends the study."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest

from pipelines.commands.sweep import study_cells
from pipelines.config.compose import load
from pipelines.config.schemas import EvaluateConfig
from pipelines.tracking.mlflow_store import client
from pipelines.tracking.runs import find_run, find_runs
from tests.pipelines.conftest import metric_history, stored_run
from tossid.studies import study as studies
from tossid.studies.cells import CELL, compute_cell

SMALL = ["sweep.models=[cn,cnrp]", "sweep.values=[4.905,9.81]", "sweep.train=['epochs=2']", "data=tosses"]

HERE = [*SMALL, "sweep.workers=1"]


@pytest.fixture
def counted(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Names of the models whose cells are computed, in order."""
    seen: list[str] = []

    def count(cell: Any, data: Any) -> Any:
        seen.append(cell.settings.model.name)
        return compute_cell(cell, data)

    monkeypatch.setattr(studies, "compute_cell", count)
    return seen


def test_a_study(beside: Path, answer: Any, counted: list[str]) -> None:
    report = answer("evaluate", "--sweep", "gravity", *HERE)
    assert [(c["model"], c["gravity"], c["seed"]) for c in report["cells"]] == [
        ("cn", 4.905, 0), ("cn", 9.81, 0), ("cnrp", 4.905, 0), ("cnrp", 9.81, 0),
    ]  # fmt: skip
    assert counted == ["cn", "cn", "cnrp", "cnrp"]
    assert (report["failed"], report["data"]) == ([], "tosses/tosses.h5")
    assert {Path(path).stem for path in report["figures"]} == {
        "gravity_sweep", "gravity_sweep_from_flight", "residual_over_toss",
    }  # fmt: skip
    assert all(Path(path).read_bytes()[:4] == b"\x89PNG" for path in report["figures"])

    # a cell is what the two commands give
    trained = answer("train", "model=cn", "model.gravity=4.905", "epochs=2", "data=tosses")
    judged = answer("evaluate", f"run={trained['run']}")
    cell = report["cells"][0]
    for name in ("position_error_pct", "rotation_error_deg", "penetration_mm", "gravity_ms2"):
        assert cell[name] == judged[name]
        assert cell["from_flight"][name] == judged["from_flight"][name]
    assert cell["gravity_ms2"]["mean"] == pytest.approx(4.905)
    assert cell["parameters"] == trained["parameters"]

    # in files
    out = Path(report["out"])
    assert json.loads((out / "cells.json").read_text()) == report["cells"]
    assert (out / "table.md").read_text().splitlines()[2].startswith("| `cn` | 4.905 | 4.91 | 0.0 | ")

    # in MLflow
    parent = find_run(report["run"], command="sweep")
    assert stored_run(parent.id).info.status == "FINISHED"
    assert {"cells.json", "cells.csv", "table.md", "config.yaml", "figures"} <= {
        path.name for path in parent.folder.iterdir()
    }
    # errors by model, a curve over the swept values, and the table in its description
    for model in ("cn", "cnrp"):
        of_model = {c["gravity"]: c["position_error_pct"]["mean"] for c in report["cells"] if c["model"] == model}
        curve = dict(metric_history(parent.id, f"position_error_pct/{model}"))
        assert curve == pytest.approx({0: of_model[4.905], 1: of_model[9.81]})
    said = stored_run(parent.id).data.tags["mlflow.note.content"]
    assert "swept gravity: 0 is 4.905, 1 is 9.81." in said
    assert (parent.folder / "table.md").read_text() in said
    nested = find_runs(parent=parent.id)
    assert {run.info.run_id for run in nested} == {c["run"] for c in report["cells"]}
    assert {run.info.status for run in nested} == {"FINISHED"}
    restarts = cell["parameters"]["convergence"]["restarts"]
    assert all(set(each) == {"stage", "what", "moved", "kept"} for each in restarts)
    assert [step for step, _ in metric_history(cell["run"], "contact/train")] == [1, 2]
    assert find_run().id == trained["run"]  # cells are not taken for the newest training
    assert answer("evaluate", f"run={cell['run']}")["position_error_pct"] == cell["position_error_pct"]

    # again: nothing is computed; what a killed command had logged is not logged twice, what it had half logged is
    counted.clear()
    ids = [c["run"] for c in report["cells"]]
    client().update_run(ids[1], status="RUNNING")
    client().delete_run(ids[2])  # by a person
    again = answer("evaluate", "--sweep", "gravity", *HERE)
    assert counted == []
    nested = find_runs(parent=parent.id)
    assert {run.info.run_id for run in nested} == {c["run"] for c in again["cells"]}
    assert [run.info.status for run in nested] == ["FINISHED"] * 4
    assert [c["run"] == old for c, old in zip(again["cells"], ids, strict=True)] == [True, False, False, True]
    for one in (again, report):
        one.pop("seconds")
        for c in one["cells"]:
            c.pop("run")
    assert again == report


def test_cells_have_the_settings_of_their_keys(made: Path) -> None:
    data = made / "tosses" / "tosses.h5"

    def cells(*keys: str) -> dict[Any, Any]:
        config = load("evaluate", EvaluateConfig, ["sweep=gravity", *SMALL, *keys])
        assert config.sweep is not None
        return study_cells(config.sweep, data, "a")

    one = cells()
    for cell, keys in one.items():
        assert cell.label == {"model": keys.model.name, "seed": keys.seed, "gravity": keys.model.gravity}
        assert (cell.settings.model, cell.settings.epochs) == (keys.model, 2)
    # who computes them, and under which name, is no part of them
    digests = [cell.digest for cell in one]
    assert [cell.digest for cell in cells("sweep.name=other", "sweep.workers=3")] == digests


@pytest.mark.slow
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGKILL])
def test_a_stopped_study_goes_on(beside: Path, answer: Any, number: signal.Signals) -> None:
    keys = [key for key in SMALL if "train=" not in key]
    with subprocess.Popen(
        [sys.executable, "-m", "pipelines.cli.app", "evaluate", "--sweep", "gravity", *keys, "sweep.workers=2"],
        cwd=beside,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    ) as running:
        deadline = time.monotonic() + 90
        while not list(beside.glob(f"outputs/sweeps/*/cells/*/{CELL}")) and time.monotonic() < deadline:
            time.sleep(0.02)
        if number == signal.SIGINT:
            os.killpg(running.pid, number)  # a terminal sends it to all
        else:
            running.send_signal(number)
        err = running.communicate(timeout=60)[1]
    time.sleep(2)
    with pytest.raises(ProcessLookupError):
        os.killpg(running.pid, 0)  # no worker outlives it
    if number == signal.SIGINT:
        assert running.returncode == 130
        assert "interrupted" in err.strip().splitlines()[-1]
        assert "Traceback" not in err
    kept = {path: path.stat().st_mtime_ns for path in beside.glob(f"outputs/sweeps/*/cells/*/{CELL}")}
    assert 0 < len(kept) < 4
    report = answer("evaluate", "--sweep", "gravity", *keys, "sweep.workers=1")
    assert len(report["cells"]) == 4
    assert {path: path.stat().st_mtime_ns for path in kept} == kept
    studies = find_runs(command="sweep")
    assert [(run.info.run_id, run.info.status) for run in studies] == [(report["run"], "FINISHED")]
