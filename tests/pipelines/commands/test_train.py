"""Training through the command: one run however often it is interrupted, and nothing is lost."""

from __future__ import annotations

import errno
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
import torch

from pipelines.cli import app
from pipelines.tracking.runs import find_run, find_runs
from tests.pipelines.conftest import KEYS, metric_history, one_line, stored_run
from tests.pipelines.test_refusals import Bomb
from tossid import outputs

TRAIN = ["train", *KEYS, "data=tosses"]
SLOW = """
import sys, time
from pipelines.cli import app
from pipelines.commands import train
from tossid.training.fit import Fit
train.SAVE_EVERY_S = 1e-9
step = Fit._step
def slow(self, *args):
    time.sleep(float(sys.argv[1]))
    return step(self, *args)
Fit._step = slow
app.main(sys.argv[2:])
"""
"""`tossid`, with time to interrupt a training."""


def parameters_in(folder: Path) -> dict[str, torch.Tensor]:
    (path,) = folder.glob("outputs/train/*/checkpoint.pt")
    state: dict[str, torch.Tensor] = torch.load(path, weights_only=True)["model"]
    return state


@contextmanager
def training(folder: Path, *, epochs: int, pause: float = 0.15) -> Iterator[subprocess.Popen[str]]:
    """A training in a process of its own that has kept so many epochs, with a pause before each step [s]."""
    with subprocess.Popen(
        [sys.executable, "-c", SLOW, str(pause), *TRAIN], stderr=subprocess.PIPE, text=True, cwd=folder
    ) as running:
        deadline, kept = time.monotonic() + 300, set[int]()  # the times at which an epoch was kept
        while time.monotonic() < deadline and running.poll() is None and len(kept) < epochs:
            kept |= {state.stat().st_mtime_ns for state in folder.glob("outputs/train/*/under_way/state.pt")}
            time.sleep(0.02)
        yield running


def unfinished() -> str:
    """The one training in the store that has not finished."""
    (left,) = [run.info.run_id for run in find_runs(command="train") if run.info.status != "FINISHED"]
    return str(left)


@pytest.mark.parametrize(
    ("number", "epochs"), [(signal.SIGINT, 2), pytest.param(signal.SIGKILL, 8, marks=pytest.mark.slow)]
)
def test_an_interrupted_training_goes_on_in_its_run(
    beside: Path, made: Path, answer: Any, number: signal.Signals, epochs: int
) -> None:
    with training(beside, epochs=epochs) as running:
        running.send_signal(number)
        err = running.communicate(timeout=30)[1]
    left = unfinished()
    if number == signal.SIGINT:
        assert running.returncode == 130
        assert "interrupted" in err.strip().splitlines()[-1]
        assert stored_run(left).info.status == "KILLED"
    assert "Traceback" not in err
    assert not list(beside.glob("outputs/train/*/checkpoint.pt"))

    assert answer(*TRAIN)["run"] == left
    run = stored_run(left)
    assert run.info.status == "FINISHED"
    steps = {name: [step for step, _ in metric_history(left, name)] for name in run.data.metrics}
    assert all(len(each) == len(set(each)) for each in steps.values())
    trained = sorted(step for name, each in steps.items() if name.endswith("/train") for step in each)
    assert trained == list(range(1, len(trained) + 1))
    assert not list(beside.glob("outputs/train/*/under_way"))
    whole, resumed = parameters_in(made), parameters_in(beside)
    assert whole.keys() == resumed.keys()
    for name, value in whole.items():
        torch.testing.assert_close(resumed[name], value, rtol=0, atol=1e-9)


@pytest.mark.slow
def test_what_becomes_of_an_interrupted_training(
    made: Path, project: Path, capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Beside a finished one. Two of the same keys do not mix; a hostile state is not run; a lost store and
    restart=true begin anew."""
    shutil.copytree(made, project, dirs_exist_ok=True)
    (checkpoint,) = project.glob("outputs/train/*/checkpoint.pt")
    before = checkpoint.read_bytes()
    with training(project, epochs=3, pause=1.0) as running:  # which outlasts another command
        again = subprocess.run([sys.executable, "-m", "pipelines.cli.app", *TRAIN], capture_output=True, text=True)
        assert again.returncode == 1
        assert f"process {running.pid}" in one_line(again.stderr)
        running.send_signal(signal.SIGTERM)
        assert running.wait(timeout=30) == 130
    assert checkpoint.read_bytes() == before

    left = unfinished()
    (state,) = project.glob("outputs/train/*/under_way/state.pt")
    shutil.copytree(state.parent, project / "kept")
    torch.save({"schema": Bomb()}, state)
    assert app.run(TRAIN) == 2
    assert "state.pt" in capfd.readouterr().err
    assert not (project / "exploded").exists()
    for keys, uri, says in (
        ([], f"sqlite:///{project / 'other.db'}", f"run {left} is not in this store"),
        (["restart=true"], f"sqlite:///{project / 'mlflow.db'}", ""),
    ):
        shutil.copytree(project / "kept", state.parent, dirs_exist_ok=True)
        monkeypatch.setenv("MLFLOW_TRACKING_URI", uri)
        assert app.run([*TRAIN, *keys]) == 0
        assert says in capfd.readouterr().err
        new = find_runs(command="train")[0].info
        assert (new.status, new.run_id != left) == ("FINISHED", True)
        assert metric_history(new.run_id, "flight/train")[0][0] == 1  # earlier epochs are there too


def test_what_train_leaves(made: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(made)
    figures = {path.name for path in (find_run().folder / "figures").iterdir()}
    assert figures == {"training_curves.png", "learned_geometry.png"}
    (folder,) = made.glob("outputs/train/*")
    assert {path.name for path in folder.iterdir()} == {"checkpoint.pt", "config.yaml", "run.json", "figures"}


def test_a_full_disk_while_the_checkpoint_is_written(
    beside: Path, capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, answer: Any
) -> None:
    short = ["train", "model=cn", "model.horizons=[]", "epochs=1", "data=tosses"]
    checkpoint = Path(answer(*short)["checkpoint"])
    before, sync = checkpoint.read_bytes(), outputs._sync

    def full(path: Path) -> None:
        if "checkpoint" in path.name:  # and not the state of a training under way
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        sync(path)

    with monkeypatch.context() as patch:
        patch.setattr(outputs, "_sync", full)
        assert app.run([*short, "--quiet"]) == 1
    assert "checkpoint.pt: cannot be written: the disk is full" in one_line(capfd.readouterr().err)
    assert checkpoint.read_bytes() == before
    failed = find_runs(command="train")[0].info
    assert failed.status == "FAILED"
    assert answer(*short)["run"] == failed.run_id  # and the run goes on
