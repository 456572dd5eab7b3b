"""A command that fails says so in one line, with the right exit code."""

from __future__ import annotations

import errno
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from pipelines.cli import app, failures
from pipelines.cli.console import Console
from tests.pipelines.conftest import one_line
from tossid.errors import FileError, SolverError


@pytest.mark.parametrize(
    ("error", "code", "words"),
    [
        (FileError("a.h5", "no HDF5 file"), 2, "a.h5: no HDF5 file"),
        (SolverError("no solution", count=2, total=9), 1, "no solution (2 of 9)"),
        (OSError(errno.ENOSPC, "No space", "x.h5"), 1, "x.h5: the disk is full"),
        (OSError(errno.EROFS, "Read-only"), 1, "read-only"),
        (PermissionError(errno.EACCES, "Denied", "x.h5"), 1, "x.h5: no permission"),
        (MemoryError(), 1, "out of memory"),
        (KeyboardInterrupt(), 130, "interrupted"),
        (ValueError("two\nlines"), 1, "this is a bug in tossid (ValueError: two lines)"),
    ],
)
def test_every_failure_is_one_line(
    command: SimpleNamespace,
    capfd: pytest.CaptureFixture[str],
    error: BaseException,
    code: int,
    words: str,
) -> None:
    def fail(path: Path, console: Console) -> dict[str, Any]:
        raise error

    command.does = fail
    assert app.run(["info", "x", "--json"]) == code
    out, err = capfd.readouterr()
    assert out == ""
    assert words in one_line(err)
    assert one_line(err).startswith("tossid info: ")


def test_a_bug_leaves_its_traceback_in_a_log(
    command: SimpleNamespace, project: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    def fail(path: Path, console: Console) -> dict[str, Any]:
        raise RuntimeError("unthought of")

    command.does = fail
    assert app.run(["info", "x"]) == 1
    (log,) = (project / failures.LOGS).iterdir()
    assert str(failures.LOGS / log.name) in capfd.readouterr().err
    assert "RuntimeError: unthought of" in log.read_text()
    assert "['info', 'x']" in log.read_text()


def test_a_wrapped_interrupt_is_one_too(command: SimpleNamespace, capfd: pytest.CaptureFixture[str]) -> None:
    def fail(path: Path, console: Console) -> dict[str, Any]:
        try:
            raise KeyboardInterrupt
        except KeyboardInterrupt as error:
            raise RuntimeError("Error calling __set_name__") from error

    command.does = fail
    assert app.run(["info", "x"]) == 130
    assert "interrupted" in one_line(capfd.readouterr().err)


def test_debug_shows_the_traceback(command: SimpleNamespace, capfd: pytest.CaptureFixture[str]) -> None:
    def fail(path: Path, console: Console) -> dict[str, Any]:
        raise FileError("a.h5", "no HDF5 file")

    command.does = fail
    assert app.run(["info", "x", "--debug"]) == 2
    err = capfd.readouterr().err
    assert "Traceback" in err
    assert err.strip().splitlines()[-1] == "tossid info: a.h5: no HDF5 file"
