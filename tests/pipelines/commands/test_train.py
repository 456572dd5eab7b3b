"""Training through the command: one run however often it is interrupted; bad input is one line; nothing is lost."""

from __future__ import annotations

import os
import pickle
import resource
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
import torch

from pipelines.cli import app
from pipelines.tracking.runs import find_run, find_runs
from tests.pipelines.conftest import KEYS, one_line
from tests.pipelines.stored import metric_history, stored_run
from tossid import outputs

SLOW = """
import sys, time
from pipelines.cli import app
from pipelines.config.schemas import TrainConfig
from tossid.training.fit import Fit
TrainConfig.save_every_s = 1e-9
init = TrainConfig.__init__
TrainConfig.__init__ = lambda self, **keys: init(self, **{"save_every_s": 1e-9, **keys})
step = Fit._step
def slow(self, *args):
    time.sleep(0.15)
    return step(self, *args)
Fit._step = slow
app.main(sys.argv[1:])
"""
"""`tossid`, with time to interrupt a training."""


def parameters_in(folder: Path) -> dict[str, torch.Tensor]:
    (path,) = folder.glob("outputs/train/*/checkpoint.pt")
    state: dict[str, torch.Tensor] = torch.load(path, weights_only=True)["model"]
    return state


def interrupt(
    folder: Path, number: signal.Signals, *, keys: list[str], epochs: int
) -> subprocess.CompletedProcess[str]:
    """Send a signal to a training of its own process once it has kept so many epochs."""
    with subprocess.Popen(
        [sys.executable, "-c", SLOW, "train", *keys, "data=tosses"], stderr=subprocess.PIPE, text=True, cwd=folder
    ) as running:
        deadline, kept = time.monotonic() + 300, set[int]()  # the times at which an epoch was kept
        while time.monotonic() < deadline and running.poll() is None and len(kept) < epochs:
            kept |= {state.stat().st_mtime_ns for state in folder.glob("outputs/train/*/under_way/state.pt")}
            time.sleep(0.02)
        running.send_signal(number)
        err = running.communicate(timeout=30)[1]
    return subprocess.CompletedProcess([], running.returncode, "", err)


@pytest.mark.parametrize(
    ("number", "epochs"), [(signal.SIGINT, 4), pytest.param(signal.SIGKILL, 16, marks=pytest.mark.slow)]
)
def test_an_interrupted_training_goes_on_in_its_run(
    beside: Path, made: Path, answer: Any, number: signal.Signals, epochs: int
) -> None:
    done = interrupt(beside, number, keys=KEYS, epochs=epochs)
    (left,) = [run for run in find_runs(command="train") if run.info.status != "FINISHED"]
    if number == signal.SIGINT:
        assert done.returncode == 130
        assert "interrupted" in done.stderr.strip().splitlines()[-1]
        assert left.info.status == "KILLED"
    assert "Traceback" not in done.stderr
    assert not list(beside.glob("outputs/train/*/checkpoint.pt"))

    again = answer("train", *KEYS, "data=tosses")
    assert again["run"] == left.info.run_id
    assert stored_run(again["run"]).info.status == "FINISHED"
    for name in ("continuous/train", "contact/validation", "contact/train"):
        steps = [step for step, _ in metric_history(again["run"], name)]
        assert len(steps) == len(set(steps))
    stages = [name for name in stored_run(again["run"]).data.metrics if name.endswith("/train")]
    steps = [step for stage in stages for step, _ in metric_history(again["run"], stage)]
    assert sorted(steps) == list(range(1, len(steps) + 1))
    assert not list(beside.glob("outputs/train/*/under_way"))
    whole, resumed = parameters_in(made), parameters_in(beside)
    assert whole.keys() == resumed.keys()
    for name, value in whole.items():
        torch.testing.assert_close(resumed[name], value, rtol=0, atol=1e-9)


@pytest.mark.slow
def test_an_interrupt_leaves_the_finished_training(beside: Path, made: Path) -> None:
    shutil.copytree(made / "outputs", beside / "outputs")
    (checkpoint,) = beside.glob("outputs/train/*/checkpoint.pt")
    before = checkpoint.read_bytes()
    assert interrupt(beside, signal.SIGTERM, keys=KEYS, epochs=1).returncode == 130
    assert checkpoint.read_bytes() == before


@pytest.mark.slow
def test_a_run_that_the_store_lost_is_begun_anew_and_said(
    beside: Path, capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    interrupt(beside, signal.SIGINT, keys=KEYS, epochs=3)
    (left,) = [run.info.run_id for run in find_runs(command="train") if run.info.status != "FINISHED"]
    monkeypatch.setenv("MLFLOW_TRACKING_URI", f"sqlite:///{beside / 'other.db'}")
    assert app.run(["train", *KEYS, "data=tosses"]) == 0
    assert f"run {left} is not in this store" in capfd.readouterr().err
    (new,) = find_runs(command="train")
    assert new.info.run_id != left
    assert metric_history(new.info.run_id, "continuous/train")[0][0] == 1  # the earlier epochs are there too


@pytest.mark.slow
def test_restart_begins_anew(beside: Path, answer: Any) -> None:
    interrupt(beside, signal.SIGINT, keys=KEYS, epochs=3)
    (left,) = [run.info.run_id for run in find_runs(command="train") if run.info.status != "FINISHED"]
    assert answer("train", *KEYS, "data=tosses", "restart=true")["run"] != left
    assert find_runs(command="train", tags={"mlflow.runName": "cnrpi-g9.81"})[1].info.status == "KILLED"


def test_what_train_leaves(made: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(made)
    record = find_run()
    assert {path.name for path in (record.folder / "figures").iterdir()} == {
        "training_curves.png",
        "learned_geometry.png",
    }
    (folder,) = made.glob("outputs/train/*")
    assert {path.name for path in folder.iterdir()} == {"checkpoint.pt", "config.yaml", "run.json", "figures"}


# ---------------------------------------------------------------- bad input


def refused(args: list[str], capfd: pytest.CaptureFixture[str], *, code: int = 2) -> str:
    """The one line of a command that must fail; nothing is left by it."""
    assert app.run([*args, "--json", "--quiet"]) == code
    out, err = capfd.readouterr()
    assert out == ""
    return one_line(err)


def test_a_truncated_dataset(beside: Path, capfd: pytest.CaptureFixture[str]) -> None:
    whole = (beside / "tosses" / "tosses.h5").read_bytes()
    (beside / "cut.h5").write_bytes(whole[: len(whole) // 2])
    for command in ("train", "evaluate"):
        run = [] if command == "train" else ["run=tosses"]
        shutil.copy(beside / "cut.h5", beside / "tosses" / "checkpoint.pt")
        (beside / "tosses" / "config.yaml").write_text("{}")
        line = refused([command, "data=cut.h5", *run], capfd)
        assert "cut.h5" in line or "checkpoint.pt" in line
    assert not (beside / "outputs").exists()


def test_a_toss_with_nan(beside: Path, capfd: pytest.CaptureFixture[str]) -> None:
    path = beside / "tosses" / "tosses.h5"
    with h5py.File(path, "r+") as file:
        name = sorted(file["tosses"])[2]
        file["tosses"][name]["q"][5, 0] = np.nan
    line = refused(["train", "data=tosses"], capfd)
    assert "tosses.h5" in line
    assert name in line
    assert "5" in line
    assert not (beside / "outputs").exists()


def test_a_dataset_without_training_tosses(beside: Path, capfd: pytest.CaptureFixture[str]) -> None:
    with h5py.File(beside / "tosses" / "tosses.h5", "r+") as file:
        for toss in file["tosses"].values():
            toss.attrs["split"] = "test"
    assert "no tosses in split 'train'" in refused(["train", "data=tosses"], capfd)


@pytest.mark.parametrize(
    ("args", "words"),
    [
        (["train", "model.gravty=3"], "Did you mean 'model.gravity'?"),
        (["train", "model=cnrip"], "there is no 'cnrip' in conf/model"),
        (["train", "model.gravity=-1"], "model.gravity: -1 is out of range"),
        (["train", "data=nowhere.h5"], "nowhere.h5: no such dataset"),
        (["train", "data=tosses", "tosses=99"], "tosses=99: the dataset has 5 training tosses"),
    ],
)
def test_wrong_calls(beside: Path, capfd: pytest.CaptureFixture[str], args: list[str], words: str) -> None:
    assert words in refused(args, capfd)
    assert not (beside / "outputs").exists()


class Bomb:
    """What a hostile file would run."""

    def __reduce__(self) -> Any:
        return os.mkdir, ("exploded",)


@pytest.mark.parametrize("kind", ["checkpoint", "toss", pytest.param("state", marks=pytest.mark.slow)])
def test_nothing_in_a_file_is_run(beside: Path, capfd: pytest.CaptureFixture[str], kind: str) -> None:
    if kind == "checkpoint":
        folder = beside / "gift"
        args, name = ["evaluate", "run=gift/"], "checkpoint.pt"
    elif kind == "state":
        assert interrupt(beside, signal.SIGINT, keys=KEYS, epochs=1).returncode == 130
        (folder,) = beside.glob("outputs/train/*/under_way")
        args, name = ["train", *KEYS, "data=tosses"], "state.pt"
    else:
        folder = beside / "gift"
        args, name = ["ingest", "source=contactnets", "source.path=gift"], "0.pt"
    folder.mkdir(exist_ok=True)
    (folder / "config.yaml").write_text("{}")
    for write in (pickle.dump, torch.save):
        with open(folder / name, "wb") as file:
            write({"schema": Bomb()}, file)
        assert name in refused(args, capfd)
        assert not (beside / "exploded").exists()


@pytest.mark.parametrize(
    ("damage", "words"),
    [
        (lambda row: row.__setitem__((7, 0), float("nan")), "NaN"),
        (lambda row: row.__setitem__((7, slice(3, 7)), 0.5 * row[7, 3:7]), "quaternion"),
    ],
)
def test_a_bad_published_toss(beside: Path, capfd: pytest.CaptureFixture[str], damage: Any, words: str) -> None:
    toss = torch.zeros(40, 19, dtype=torch.float64)
    toss[:, 2], toss[:, 3] = 3 - 0.05 * torch.arange(40), 1.0
    damage(toss)
    (beside / "gift").mkdir()
    torch.save(toss[None], beside / "gift" / "0.pt")
    (beside / "a.h5").write_text("old")
    line = refused(["ingest", "source=contactnets", "source.path=gift", "out=a.h5"], capfd)
    assert "0.pt" in line
    assert "7" in line
    assert words in line
    assert (beside / "a.h5").read_text() == "old"


def test_a_trajectory_that_misses_a_column(beside: Path, capfd: pytest.CaptureFixture[str]) -> None:
    (beside / "poses").mkdir()
    rows = [f"{0.01 * i:.2f} 0 0 {1 - 0.01 * i} 0 0 0 1" for i in range(20)]
    rows[7] = rows[7].rpartition(" ")[0]
    (beside / "poses" / "a.txt").write_text("\n".join(rows))
    line = refused(["ingest", "source=tum", "source.path=poses"], capfd)
    assert "a.txt" in line
    assert not (beside / "data").exists() or not list((beside / "data").rglob("*.h5"))


# ---------------------------------------------------------------- a disk that refuses


def test_a_full_disk_while_the_checkpoint_is_written(
    beside: Path, made: Path, capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, answer: Any
) -> None:
    import errno

    shutil.copytree(made / "outputs", beside / "outputs")
    (checkpoint,) = beside.glob("outputs/train/*/checkpoint.pt")
    before, sync = checkpoint.read_bytes(), outputs._sync

    def full(path: Path) -> None:
        if "checkpoint" in path.name:  # and not the state of a training under way, which a slow machine keeps, too
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        sync(path)

    monkeypatch.setattr(outputs, "_sync", full)
    line = refused(["train", *KEYS, "data=tosses"], capfd, code=1)
    assert "checkpoint.pt: cannot be written: the disk is full" in line
    assert checkpoint.read_bytes() == before
    failed = find_runs(command="train")[0].info
    assert failed.status == "FAILED"
    monkeypatch.setattr(outputs, "_sync", sync)
    assert answer("train", *KEYS, "data=tosses")["run"] == failed.run_id  # and the run goes on


@pytest.mark.slow
def test_a_store_that_cannot_grow(beside: Path) -> None:
    def limited() -> None:
        resource.setrlimit(resource.RLIMIT_FSIZE, (48_000, 48_000))

    command = [sys.executable, "-m", "pipelines.cli.app", "train", *KEYS, "data=tosses", "--quiet"]
    done = subprocess.run(command, capture_output=True, text=True, cwd=beside, preexec_fn=limited, timeout=120)
    assert done.returncode == 1
    assert "MLflow's store" in one_line(done.stderr)


def test_a_store_that_was_not_finished_is_made_again(project: Path) -> None:
    """MLflow itself cannot open a store whose making was cut short."""
    (project / "mlflow.db").write_bytes(b"half of a store")
    (project / "mlflow.making").write_bytes(b"making")
    assert find_runs() == []
    assert (project / "mlflow.db.unfinished").read_bytes() == b"half of a store"
    assert not (project / "mlflow.making").exists()


@pytest.mark.slow
def test_two_trainings_of_the_same_keys_do_not_mix(beside: Path, capfd: pytest.CaptureFixture[str]) -> None:
    with subprocess.Popen(
        [sys.executable, "-c", SLOW, "train", *KEYS, "data=tosses"], stderr=subprocess.DEVNULL, cwd=beside
    ) as running:
        deadline = time.monotonic() + 60
        while not list(beside.glob("outputs/train/*/under_way/run.json")) and time.monotonic() < deadline:
            time.sleep(0.05)
        assert f"process {running.pid}" in refused(["train", *KEYS, "data=tosses"], capfd, code=1)
        running.send_signal(signal.SIGINT)
        assert running.wait(timeout=30) == 130
