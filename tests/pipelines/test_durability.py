"""kill -9 at random moments, two commands at once on one folder, a full or read-only disk:
nothing is lost or half written, a rerun completes, and who cannot go on says so in one line. No port is open meanwhile.

`KILLS=200` spreads so many over the commands; a process that had ended by then does not count.
"""

from __future__ import annotations

import ipaddress
import itertools
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from pipelines.tracking.runs import find_runs
from tests.pipelines.conftest import one_line
from tests.pipelines.disturbed import COMMANDS, can_mount, check_all, files, hooked, on_a_disk, start

KILLS = int(os.environ.get("KILLS", "28"))
EACH = max(1, round(KILLS / len(COMMANDS)))
RERUN_EVERY = 4
WRITERS = ["ingest", "train", "evaluate", "diagnose"]
FREE_KB = {"read-only": None, "full": 0, "64 KiB": 64, "1 MiB": 1024}
"""Space that is left on the disk. With 1 MiB, some commands fail late, when much is written."""
REFUSALS = ("disk is full", "read-only", "Read-only", "no permission")
PORTS = """
import os, sys
def note(event, args):
    if event == "socket.bind" and isinstance(args[1], tuple):
        with open(os.environ["BOUND"], "a") as log:
            log.write(f"{args[1][0]}\\n")
sys.addaudithook(note)
"""
"""Notes every address that a Python process, or a child of it, binds."""


def completes(name: str, folder: Path, turn: int = 1, **more: str) -> float:
    """Seconds of a run that ends well."""
    started = time.monotonic()
    with start(name, folder, turn, **more) as running:
        err = running.communicate(timeout=600)[1]
    kept = name == "new-object" and "is there already" in err  # which it says of a whole one only
    assert running.returncode == 0 or kept, err[-2000:]
    return time.monotonic() - started


def outside(log: Path) -> list[str]:
    """Addresses that were bound and that another machine can reach."""
    bound = log.read_text().split("\n")[:-1] if log.exists() else []
    return [address for address in bound if not address or not ipaddress.ip_address(address).is_loopback]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """A project in which every command has completed once, and opened no port to other machines."""
    folder, hook = tmp_path_factory.mktemp("project"), tmp_path_factory.mktemp("hook")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        patch.delenv("MLFLOW_TRACKING_URI", raising=False)
        for name in COMMANDS:
            log = hook / name
            completes(name, folder, **hooked(hook, PORTS, BOUND=str(log)))
            assert outside(log) == [], name
        yield folder


def test_an_open_port_is_noticed(tmp_path: Path) -> None:
    script = "import socket; s = socket.socket(); s.bind(('0.0.0.0', 0)); t = socket.socket(); t.bind(('127.0.0.1', 0))"
    more = hooked(tmp_path / "hook", PORTS, BOUND=str(tmp_path / "bound"))
    subprocess.run([sys.executable, "-c", script], env=os.environ | more, check=True, timeout=60)
    assert outside(tmp_path / "bound") == ["0.0.0.0"]


@pytest.mark.slow
@pytest.mark.parametrize("name", COMMANDS)
def test_a_killed_command_leaves_whole_files_and_runs_again(name: str, folder: Path) -> None:
    seconds = completes(name, folder)
    rng = np.random.default_rng(sum(map(ord, name)))
    kills, turn, since = 0, 2, 0
    while kills < EACH:
        before = files(folder)
        with start(name, folder, turn) as running:
            time.sleep(rng.uniform(0.2, 1.0) * seconds)
            ended = running.poll() is not None
            if not ended:
                os.killpg(running.pid, signal.SIGKILL)
            running.communicate(timeout=60)
        kills, since = kills + (not ended), since + 1
        check_all(folder, before)
        if ended or since == RERUN_EVERY or kills == EACH:
            completes(name, folder, turn)
            check_all(folder, before)
            turn, since = turn + 1, 0


@pytest.mark.slow
@pytest.mark.parametrize(("one", "other"), list(itertools.combinations_with_replacement(WRITERS, 2)))
def test_two_at_once(one: str, other: str, folder: Path) -> None:
    before, known = files(folder), {run.info.run_id for run in find_runs(nested=True)}
    running = [start(name, folder) for name in (one, other)]
    ended = [(process.communicate(timeout=600)[1], process.returncode) for process in running]
    refused = [one_line(err) for err, code in ended if code]
    assert len(refused) <= (one == other)
    assert all("is being written by another tossid command" in line for line in refused)
    check_all(folder, before)
    made = [run for run in find_runs(nested=True) if run.info.run_id not in known]
    assert {run.info.status for run in made} <= {"FINISHED", "FAILED"}


@pytest.mark.slow
@pytest.mark.skipif(not can_mount(), reason="no disk can be mounted here (unshare --user --mount)")
@pytest.mark.parametrize("free", FREE_KB)
@pytest.mark.parametrize("name", WRITERS)
def test_a_disk_that_refuses(name: str, free: str, folder: Path, tmp_path: Path) -> None:
    before = {path.relative_to(folder): path.read_bytes() for path in files(folder)}
    code, err, after = on_a_disk(name, folder, tmp_path, free_kb=FREE_KB[free])
    if code or not FREE_KB[free]:
        assert code == 1, err
        assert any(words in one_line(err) for words in REFUSALS), err
    for path, content in before.items():
        assert path.suffix == ".db" or code == 0 or (after / path).read_bytes() == content, path
    check_all(after, {after / path for path in before})
