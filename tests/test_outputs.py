"""Outputs appear whole or not at all, whatever ends the command; locks hold, and end with their holder."""

from __future__ import annotations

import errno
import fcntl
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from tossid import outputs
from tossid.errors import InputError, OutputError
from tossid.locks import OWNED, LockHeld, held
from tossid.outputs import move_files, output_file, output_folder, recover_folder


def entries(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


def write(out: Path, content: str, error: BaseException | None = None) -> None:
    """Write a file, or a folder (of a name without a suffix) that holds a file of this name; end in an error if any."""
    with output_file(out) if out.suffix else output_folder(out, made_by="test") as temporary:
        (temporary if out.suffix else temporary / content).write_text(content)
        assert not out.suffix or temporary.suffix == out.suffix
        if error is not None:
            raise error


@pytest.mark.parametrize("error", [RuntimeError(), KeyboardInterrupt()])
def test_an_output_appears_when_it_is_whole_and_an_error_leaves_what_was_there(
    tmp_path: Path, error: BaseException
) -> None:
    out, rec, thesis = tmp_path / "deep" / "a.h5", tmp_path / "rec", tmp_path / "thesis"
    with output_file(out) as temporary:
        temporary.write_text("new")
        assert not out.exists()
    rec.mkdir()  # an empty folder is taken
    for content in ("old", "new"):
        write(rec, content)
    for each in (out, rec):
        with pytest.raises(type(error)):
            write(each, "half", error)
    assert out.read_text() == "new"
    assert entries(rec) == [outputs.MARKER, "new"]
    assert entries(out.parent) == ["a.h5"]
    thesis.mkdir()
    (thesis / "chapter.tex").write_text("years of work")
    with pytest.raises(InputError, match="did not write"):
        write(thesis, "half")
    with pytest.raises(InputError, match="is a folder"), output_file(tmp_path):
        pass
    assert entries(thesis) == ["chapter.tex"]
    assert entries(tmp_path) == ["deep", "rec", "thesis"]


def test_a_replacement_that_died_halfway_is_put_back(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / ".rec.old").mkdir()
    (tmp_path / ".rec.old" / "kept").write_text("kept")
    recover_folder(tmp_path / "rec")
    assert (tmp_path / "rec" / "kept").read_text() == "kept"
    (tmp_path / ".rec.old").mkdir()
    monkeypatch.chdir(tmp_path / "rec")
    recover_folder(Path("."))  # by its name
    assert entries(tmp_path) == ["rec"]


def test_files_take_the_places_of_others(tmp_path: Path) -> None:
    for name, content in {"new/a": "2", "new/in/b": "2", "old/a": "1", "old/c": "1"}.items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(content)
    move_files(tmp_path / "new", tmp_path / "old")
    found = {path.relative_to(tmp_path / "old"): path.read_text() for path in (tmp_path / "old").rglob("?")}
    assert found == {Path("a"): "2", Path("in/b"): "2", Path("c"): "1"}


@pytest.mark.parametrize(
    ("code", "words"), [(errno.ENOSPC, "disk is full"), (errno.EROFS, "read-only"), (errno.EACCES, "no permission")]
)
def test_the_disks_refusals_become_one_error(tmp_path: Path, code: int, words: str) -> None:
    out = tmp_path / "a.h5"
    out.write_text("old")
    for raised in (lambda _: OSError(code, os.strerror(code)), lambda temporary: OutputError(f"{temporary}: no")):
        with pytest.raises(OutputError, match=words) as caught, output_file(out) as temporary:
            temporary.write_text("half")
            raise raised(temporary) from OSError(code, os.strerror(code))
        assert str(caught.value).startswith(str(out))  # and no word of the temporary file
    assert out.read_text() == "old"
    assert entries(tmp_path) == ["a.h5"]


def test_errors_about_other_files_are_not_blamed_on_the_output(tmp_path: Path) -> None:
    (tmp_path / "out").mkdir()
    with pytest.raises(PermissionError), output_file(tmp_path / "out" / "a.h5"):
        raise PermissionError(errno.EACCES, "no", str(tmp_path / "input.h5"))


WRITER = """
import sys, time
from pathlib import Path
from tossid.outputs import output_file, output_folder
out = Path(sys.argv[1])
with output_file(out) if out.suffix else output_folder(out, made_by="test") as temporary:
    (temporary if out.suffix else temporary / "half").write_text("half")
    print("writing", flush=True)
    time.sleep(float(sys.argv[2]))
    (temporary if out.suffix else temporary / "whole").write_text("whole" * 1000)
"""


@pytest.mark.parametrize(
    ("name", "number", "left"),
    [("a.h5", signal.SIGINT, 1), ("a.h5", signal.SIGKILL, 3), ("rec", signal.SIGKILL, 3)],
)
def test_a_killed_writer_leaves_what_was_there(tmp_path: Path, name: str, number: signal.Signals, left: int) -> None:
    out = tmp_path / name
    write(out, "old")
    words = [sys.executable, "-c", WRITER, str(out), "60"]
    with subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as writer:
        assert writer.stdout.readline() == b"writing\n"
        with pytest.raises(OutputError, match=str(writer.pid)):
            write(out, "second")
        writer.send_signal(number)
        writer.communicate(timeout=20)
    assert (out if out.suffix else out / "old").read_text() == "old"
    assert len(entries(tmp_path)) == left  # a killed process cannot tidy up
    write(out, "new")  # the next one does, and is not held back by a dead one's lock
    assert (out if out.suffix else out / "new").read_text() == "new"
    assert entries(tmp_path) == [name]


def test_other_outputs_temporaries_are_left_alone(tmp_path: Path) -> None:
    others = [".ab.tmp-1-00000000.h5", ".a.tmp-1-00000000.txt", ".a.tmp-mine.h5"]
    for name in others:
        (tmp_path / name).write_text("")
    (tmp_path / ".a.tmp-1-00000000.h5").write_text("")
    with output_file(tmp_path / "a.h5") as temporary:
        temporary.write_text("new")
    assert entries(tmp_path) == sorted([*others, "a.h5"])


def test_many_writers_leave_one_whole_file(tmp_path: Path) -> None:
    words = [sys.executable, "-c", WRITER, str(tmp_path / "a.h5"), "0.02"]
    writers = [subprocess.Popen(words, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) for _ in range(4)]
    assert 0 in [writer.wait(timeout=60) for writer in writers]
    assert (tmp_path / "a.h5").read_text() == "whole" * 1000
    assert entries(tmp_path) == ["a.h5"]


# ---------------------------------------------------------------- locks, also without `flock`


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
