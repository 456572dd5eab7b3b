"""Locks hold, and end with their holder: by `flock`, and without it by a file that names its owner."""

from __future__ import annotations

import errno
import fcntl
import os
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from tossid.errors import OutputError
from tossid.locks import OWNED, LockHeld, held
from tossid.outputs import output_file

WITHOUT_FLOCK = """
import errno, fcntl, os, sys, time
def refuse(*args): raise OSError(errno.ENOLCK, "No locks available")
fcntl.flock = refuse
from pathlib import Path
from tossid.locks import held
with held(Path(sys.argv[1])):
    print("held", flush=True)
    time.sleep(60)
"""


@pytest.fixture(params=[errno.ENOSYS, errno.EOPNOTSUPP, errno.ENOLCK])
def no_flock(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object) -> None:
        raise OSError(request.param, os.strerror(request.param))

    monkeypatch.setattr(fcntl, "flock", refuse)


@pytest.fixture
def other(tmp_path: Path) -> Iterator[subprocess.Popen[str]]:
    """Another process that holds `tmp_path/lock` without `flock`."""
    args = [sys.executable, "-c", WITHOUT_FLOCK, str(tmp_path / "lock")]
    with subprocess.Popen(args, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "held\n"
        yield process
        process.kill()


def test_a_lock_is_held_by_one_and_leaves_nothing(tmp_path: Path) -> None:
    with held(tmp_path / "lock"), pytest.raises(LockHeld, match=f"process {os.getpid()}"), held(tmp_path / "lock"):
        pass
    assert list(tmp_path.iterdir()) == []


def test_who_waits_gets_it_next(tmp_path: Path) -> None:
    came: list[str] = []

    def second() -> None:
        with held(tmp_path / "lock", wait=True):
            came.append("second")

    with held(tmp_path / "lock"):
        waiting = threading.Thread(target=second)
        waiting.start()
        time.sleep(0.2)
        came.append("first")
    waiting.join(10)
    assert came == ["first", "second"]


@pytest.mark.usefixtures("no_flock")
def test_without_flock_an_output_is_written_and_nothing_is_left(tmp_path: Path) -> None:
    with output_file(tmp_path / "a.txt") as temporary:
        temporary.write_text("whole")
        assert [path.name for path in tmp_path.glob(".*.owned")] == [".a.txt.lock.owned"]
        with pytest.raises(
            OutputError, match=rf"written by another.*process {os.getpid()} on .*if that is dead, remove"
        ):
            output_file(tmp_path / "a.txt").__enter__()
    assert [path.name for path in tmp_path.iterdir()] == ["a.txt"]


@pytest.mark.usefixtures("no_flock")
def test_without_flock_a_living_owner_is_respected_and_a_dead_one_is_not(
    tmp_path: Path, other: subprocess.Popen[str]
) -> None:
    with pytest.raises(LockHeld, match=f"process {other.pid} on"), held(tmp_path / "lock"):
        pass
    other.kill()
    other.wait()
    assert (tmp_path / f"lock{OWNED}").exists()  # nobody removed it
    with held(tmp_path / "lock", wait=True):
        assert (tmp_path / f"lock{OWNED}").read_text().split()[0] == str(os.getpid())
    assert list(tmp_path.iterdir()) == []


@pytest.mark.usefixtures("no_flock")
def test_without_flock_an_owner_on_another_machine_cannot_be_asked(tmp_path: Path) -> None:
    (tmp_path / f"lock{OWNED}").write_text("1\nelsewhere\n")
    with (
        pytest.raises(LockHeld, match=r"process 1 on elsewhere; if that is dead, remove .*lock\.owned"),
        held(tmp_path / "lock"),
    ):
        pass


def test_any_other_refusal_is_the_disks_own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object) -> None:
        raise OSError(errno.EIO, os.strerror(errno.EIO))

    monkeypatch.setattr(fcntl, "flock", refuse)
    with pytest.raises(OutputError, match="input/output error"), output_file(tmp_path / "a.txt"):
        pass
