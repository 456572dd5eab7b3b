"""Two commands at once on one folder, a clock that jumps back, a read-only and a full disk: nothing is lost or half
written, and who cannot go on says so in one line."""

from __future__ import annotations

import itertools
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from pipelines.cli import app
from pipelines.tracking.runs import find_runs
from tests.pipelines.commands.rough import can_mount, jumping, on_a_disk, tossid
from tests.pipelines.commands.test_diagnose import FEW
from tests.pipelines.commands.test_kills import FILM, check_whole, files
from tests.pipelines.conftest import KEYS, one_line

COMMANDS = {
    "ingest": ["ingest", "source=frames", "source.path=film", "out=ingested.h5"],
    "train": ["train", *KEYS, "data=tosses"],
    "evaluate": ["evaluate", "data=tosses", "run=RUN"],
    "diagnose": ["diagnose", "data=tosses", "tosses=6", "repeats=0", "out=gap", FEW],
}
PAIRS = list(itertools.combinations_with_replacement(COMMANDS, 2))
FREE_KB = [None, 0, 64, 1024]
"""Space that is left on the disk; None: it is read-only. With 1 MiB, some commands fail late, when much is written."""
OF_SQLITE = ("-wal", "-shm", "-journal")
"""Ends of the names of files that SQLite makes and removes as it needs them."""
REFUSALS = ("disk is full", "read-only", "Read-only", "no permission")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """A project in which each command has completed once."""
    folder = tmp_path_factory.mktemp("project")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        patch.delenv("MLFLOW_TRACKING_URI", raising=False)
        keys = ["frames=false", "engine=lcp", "tosses=10", "seconds=0.8", "noise.position=0.0005"]
        assert app.run(["synthesize", *keys, "out=tosses", "--quiet"]) == 0
        assert app.run(["synthesize", *FILM, "out=film", "--quiet"]) == 0
        for name in COMMANDS:
            assert app.run([*keys_of(name, folder), "--quiet"]) == 0
        yield folder


def keys_of(name: str, folder: Path) -> list[str]:
    """The keys of a command; RUN is the project's training."""
    trained = next(folder.glob("outputs/train/*/checkpoint.pt"), folder / "none/none")
    return [key.replace("RUN", str(trained.parent.relative_to(folder))) for key in COMMANDS[name]]


def check_all(folder: Path, before: set[Path]) -> None:
    """Nothing is lost, and everything is whole."""
    after = files(folder)
    before = {path for path in before if not path.name.endswith(OF_SQLITE)}
    assert before <= after, f"lost: {before - after}"
    for path in sorted(after):
        check_whole(path)


@pytest.mark.slow
@pytest.mark.parametrize(("one", "other"), PAIRS)
def test_two_at_once(one: str, other: str, folder: Path) -> None:
    before = files(folder)
    running = [tossid(folder, *keys_of(name, folder)) for name in (one, other)]
    ended = [(process.communicate(timeout=600)[1], process.returncode) for process in running]
    refused = [one_line(err) for err, code in ended if code]
    assert len(refused) <= (one == other)
    assert all("is being written by another tossid command" in line for line in refused)
    check_all(folder, before)
    assert {run.info.status for run in find_runs(nested=True)} <= {"FINISHED", "FAILED"}


@pytest.mark.slow
@pytest.mark.parametrize("name", COMMANDS)
def test_a_clock_that_jumps_back_by_an_hour(name: str, folder: Path, tmp_path: Path) -> None:
    before, known = files(folder), {run.info.run_id for run in find_runs()}
    began = time.monotonic()
    with tossid(folder, *keys_of(name, folder)) as undisturbed:
        assert undisturbed.wait(600) == 0
    seconds = time.monotonic() - began
    for part in (0.3, 0.8):
        with tossid(folder, *keys_of(name, folder), **jumping(tmp_path / "hook", part * seconds)) as running:
            err = running.communicate(timeout=600)[1]
            assert running.returncode == 0, err
        check_all(folder, before)
    made = [run for run in find_runs() if run.info.run_id not in known]
    assert len(made) == (0 if name == "ingest" else 3)
    assert {run.info.status for run in made} <= {"FINISHED"}


@pytest.mark.slow
@pytest.mark.skipif(not can_mount(), reason="no disk can be mounted here (unshare --user --mount)")
@pytest.mark.parametrize("free_kb", FREE_KB, ids=["read-only", "full", "64 KiB", "1 MiB"])
@pytest.mark.parametrize("name", COMMANDS)
def test_a_disk_that_refuses(name: str, free_kb: int | None, folder: Path, tmp_path: Path) -> None:
    before = {path.relative_to(folder): path.read_bytes() for path in files(folder)}
    done, after = on_a_disk(folder, tmp_path, *keys_of(name, folder), free_kb=free_kb)
    if done.returncode or not free_kb:
        assert done.returncode == 1, done.stderr
        line = one_line(done.stderr)
        assert any(words in line for words in REFUSALS), line
        print(f"{name}, {free_kb}: {line}")
    for path, content in before.items():
        own = path.name.endswith((".db", *OF_SQLITE))
        assert own or done.returncode == 0 or (after / path).read_bytes() == content, path
    check_all(after, {after / path for path in before})
