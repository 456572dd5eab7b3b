"""A command that fails says so in one line, with the right exit code."""

from __future__ import annotations

import errno
from collections.abc import Callable
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


def _itself() -> Exception:
    error = FileError("cameras.yaml", "cam0.intrinsics is 5")
    error.__cause__ = error
    return error


def _two_that_cause_each_other() -> Exception:
    first, second = ValueError("first"), FileError("cameras.yaml", "cam0.intrinsics is 5")
    first.__cause__, second.__context__ = second, first
    return second


def _a_chain_that_ends_in_a_loop() -> Exception:
    error = FileError("cameras.yaml", "cam0.intrinsics is 5")
    error.__cause__ = _itself()
    return error


@pytest.mark.parametrize("looped", [_itself, _two_that_cause_each_other, _a_chain_that_ends_in_a_loop])
def test_a_chain_of_causes_that_leads_back_to_itself_ends(
    command: SimpleNamespace, capfd: pytest.CaptureFixture[str], looped: Callable[[], Exception]
) -> None:
    def fail(path: Path, console: Console) -> dict[str, Any]:
        raise looped()

    command.does = fail
    assert app.run(["info", "x"]) == 2
    assert one_line(capfd.readouterr().err).endswith("cameras.yaml: cam0.intrinsics is 5")


def test_an_interrupt_in_a_loop_of_causes_is_found() -> None:
    outer, stop, inner = RuntimeError("Error calling __set_name__"), KeyboardInterrupt(), ValueError()
    outer.__cause__, stop.__context__, inner.__cause__ = stop, inner, outer
    assert failures.was_interrupted(outer)
    assert not failures.was_interrupted(_two_that_cause_each_other())


def test_debug_shows_the_traceback(command: SimpleNamespace, capfd: pytest.CaptureFixture[str]) -> None:
    def fail(path: Path, console: Console) -> dict[str, Any]:
        raise FileError("a.h5", "no HDF5 file")

    command.does = fail
    assert app.run(["info", "x", "--debug"]) == 2
    err = capfd.readouterr().err
    assert "Traceback" in err
    assert err.strip().splitlines()[-1] == "tossid info: a.h5: no HDF5 file"
