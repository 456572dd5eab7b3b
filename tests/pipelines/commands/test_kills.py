"""kill -9 at random moments of every command: no output is ever half written, none of before is lost, and a rerun
completes. `KILLS=200` spreads so many over the commands; a process that had ended by then does not count."""

from __future__ import annotations

import json
import os
import signal
import sqlite3
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import cv2
import numpy as np
import pytest

from pipelines.cli import app
from tests.pipelines.conftest import KEYS
from tossid import TrainedModel
from tossid.objects import load_object
from tossid.store import read_dataset

FILM = ["tosses=1", "camera.count=2", "camera.samples=2", "camera.pause_s=[0.1,0.1]", "camera.carry_s=[0.2,0.2]"]
SWEEP = ["sweep.models=[cn,cnrp]", "sweep.values=[4.905,9.81]", "sweep.train=['epochs=2']", "sweep.workers=1"]
AUDIT = ["tosses=6", "cases=1", "engines=[lcp]", "workers=1"]
COMMANDS = {
    "synthesize": ["synthesize", "frames=false", "engine=lcp", "tosses=4", "seconds=0.5", "out=made"],
    "film": ["synthesize", *FILM, "out=filmed"],
    "ingest": ["ingest", "source=frames", "source.path=film", "out=ingested.h5"],
    "detect": ["detect", "recording=film", "out=detections.npz"],
    "track": ["track", "recording=film", "detections=found.npz", "out=tracks.npz"],
    "segment": ["segment", "recording=film", "poses=tracked.npz", "out=parts.h5"],
    "train": ["train", *KEYS, "data=tosses"],
    "evaluate": ["evaluate", "data=tosses", "run=RUN"],
    "sweep": ["evaluate", "--sweep", "gravity", *SWEEP, "sweep.seeds=[ROUND]", "data=tosses"],
    "diagnose": ["diagnose", "data=tosses", "tosses=6", "repeats=0", "out=gap"],
    "audit": ["audit", *AUDIT, "seed=ROUND", "out=audited-ROUND"],
    "export": ["export", "run=RUN", "format=urdf", "out=here/cube.urdf"],
    "register": ["register", "name=cube", "run=RUN"],
    "new-object": ["new-object", "name=brickROUND", "box=[0.2,0.1,0.06]", "mass=0.8", "out=brickROUND"],
    "view": ["view", "recording=film", "sheet=sheet.png"],
}
"""ROUND: counts the reruns that completed, for what would go on with what is done and find nothing left to do."""
KILLS = int(os.environ.get("KILLS", "28"))
EACH = max(1, round(KILLS / len(COMMANDS)))
RERUN_EVERY = 4


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """A project in which every command has completed once."""
    folder = tmp_path_factory.mktemp("project")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        patch.delenv("MLFLOW_TRACKING_URI", raising=False)
        keys = ["frames=false", "engine=lcp", "tosses=10", "seconds=0.8", "noise.position=0.0005"]
        assert app.run(["synthesize", *keys, "out=tosses", "--quiet"]) == 0
        assert app.run(["synthesize", *FILM, "out=film", "--quiet"]) == 0
        assert app.run(["detect", "recording=film", "out=found.npz", "--quiet"]) == 0
        assert app.run(["track", "recording=film", "detections=found.npz", "out=tracked.npz", "--quiet"]) == 0
        yield folder


def tossid(name: str, folder: Path, turn: int) -> subprocess.Popen[bytes]:
    trained = next(folder.glob("outputs/train/*/checkpoint.pt"), folder / "none")
    args = [arg.replace("ROUND", str(turn)).replace("RUN", str(trained.parent)) for arg in COMMANDS[name]]
    return subprocess.Popen(
        [sys.executable, "-m", "pipelines.cli.app", *args, "--quiet"],
        cwd=folder,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        start_new_session=True,
    )


def completes(name: str, folder: Path, turn: int = 0) -> float:
    """Seconds of a run that ends well."""
    started = time.monotonic()
    with tossid(name, folder, turn) as running:
        err = running.communicate(timeout=300)[1].decode()
    kept = name == "new-object" and "is there already" in err  # which it says of a whole one only: see `check_whole`
    assert running.returncode == 0 or kept, err[-2000:]
    return time.monotonic() - started


def files(folder: Path) -> set[Path]:
    """What is visible of a project."""
    hidden = (".", "under_way")
    return {
        path
        for path in folder.rglob("*")
        if path.is_file() and not any(part.startswith(hidden) for part in path.relative_to(folder).parts)
    }


def check_whole(path: Path) -> None:
    """Reading a file by what it is; raises if it is damaged."""
    suffix = path.suffix
    if suffix == ".h5":
        read_dataset(path)
    elif suffix == ".npz":
        with np.load(path, allow_pickle=False) as archive:
            assert [archive[key] for key in archive.files]
    elif suffix == ".json":
        json.loads(path.read_text())
    elif suffix == ".pt":
        TrainedModel.load(path)
    elif suffix in (".png", ".jpg"):
        assert cv2.imread(str(path)) is not None
    elif suffix in (".xml", ".urdf"):
        load_object(path)
    elif suffix == ".html":
        assert path.read_text().rstrip().endswith("</html>")
    elif suffix == ".db":
        with closing(sqlite3.connect(path)) as store:
            assert store.execute("PRAGMA integrity_check").fetchone() == ("ok",)


@pytest.mark.slow
@pytest.mark.parametrize("name", COMMANDS)
def test_a_killed_command_leaves_whole_files_and_runs_again(name: str, folder: Path) -> None:
    if name in ("evaluate", "export", "register") and not list(folder.glob("outputs/train/*/checkpoint.pt")):
        completes("train", folder)
    seconds = completes(name, folder)
    rng = np.random.default_rng(sum(map(ord, name)))
    kills, turn, since = 0, 1, 0
    while kills < EACH:
        before = files(folder)
        with tossid(name, folder, turn) as running:
            time.sleep(rng.uniform(0.2, 1.0) * seconds)
            ended = running.poll() is not None
            if not ended:
                os.killpg(running.pid, signal.SIGKILL)
            running.communicate(timeout=60)
        kills, since = kills + (not ended), since + 1
        after = files(folder)
        assert before <= after, f"lost: {before - after}"
        for path in sorted(after):
            check_whole(path)
        if ended or since == RERUN_EVERY or kills == EACH:
            completes(name, folder, turn)
            for path in sorted(files(folder)):
                check_whole(path)
            turn, since = turn + 1, 0
