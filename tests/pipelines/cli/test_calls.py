"""The result alone is on standard output, what a person sees on standard error; a command that fails says so in one
line, with the right exit code."""

from __future__ import annotations

import errno
import json
import logging
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from pipelines.cli import app, failures
from pipelines.cli import call as calling
from pipelines.cli.console import Console, reported
from tests.pipelines.conftest import one_line
from tossid.errors import FileError, SolverError
from tossid.ingestion.progress import Progress


@pytest.fixture
def command(project: Path, monkeypatch: pytest.MonkeyPatch) -> SimpleNamespace:
    """`tossid info FILE`, with what it does replaced by `.does`."""
    stand_in = SimpleNamespace(does=lambda path, console: {})
    monkeypatch.setattr(calling, "_runner", lambda command: lambda path, console: stand_in.does(path, console))
    return stand_in


@pytest.fixture
def failing(command: SimpleNamespace) -> Callable[[BaseException], None]:
    """Make the command raise an error."""

    def fail_with(error: BaseException) -> None:
        def fail(path: Path, console: Console) -> dict[str, Any]:
            raise error

        command.does = fail

    return fail_with


# ---------------------------------------------------------------- what is said


def test_json_is_all_there_is_on_standard_output(command: SimpleNamespace, capfd: pytest.CaptureFixture[str]) -> None:
    def noisy(path: Path, console: Console) -> dict[str, Any]:
        print("a library's chatter")
        os.write(1, b"a C library's chatter\n")
        subprocess.run(["echo", "a child's chatter"], check=True)
        console.say("for people")
        console.table(["name", "value"], [["a", 1.0]])
        console.warn("careful")
        return {"path": path.file, "mean": np.float64(2.5), "bad": float("nan"), "list": np.arange(3), "flag": np.True_}

    command.does = noisy
    assert app.run(["info", "x", "--json"]) == 0
    out, err = capfd.readouterr()
    assert json.loads(out) == {"path": "x", "mean": 2.5, "bad": None, "list": [0, 1, 2], "flag": True}
    for words in ("a library's", "a C library's", "a child's", "for people", "warning: careful"):
        assert words in err
    assert app.run(["info", "x"]) == 0
    assert capfd.readouterr().out == ""


def test_what_the_library_logs_is_said_once_and_quiet_leaves_warnings_only(
    command: SimpleNamespace, capfd: pytest.CaptureFixture[str]
) -> None:
    def talk(path: Any, console: Console) -> dict[str, Any]:
        for _ in range(2):
            logging.getLogger("tossid.objects").info("thing.xml states friction 0.9")
            logging.getLogger("tossid.objects").warning("0.18 is a guess")
        logging.getLogger("elsewhere").warning("not ours")
        console.say("news")
        with console.progress("work", 3) as progress:
            progress.advance(3)
        with reported(console) as show:
            show(Progress("detect", message="12 images"))
            show(Progress("detect", message="one is broken", is_problem=True))
        return {}

    command.does = talk
    assert app.run(["info", "x"]) == 0
    said = capfd.readouterr().err.splitlines()
    assert [line for line in said if "not ours" not in line] == [
        "thing.xml states friction 0.9", "warning: 0.18 is a guess", "news", "12 images", "warning: one is broken"
    ]  # fmt: skip
    assert app.run(["info", "x", "--quiet"]) == 0
    said = capfd.readouterr().err.splitlines()
    assert [line for line in said if "not ours" not in line] == ["warning: 0.18 is a guess", "warning: one is broken"]
    assert not logging.getLogger("tossid").handlers


def test_each_stage_that_counts_says_so_now_and_then_and_how_long_it_takes(
    capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    with reported(Console(interval=0.0)) as show:
        for stage in ("detect", "track"):
            for _ in range(2):
                show(Progress(stage, done=1, total=2, unit="frames"))
    lines = [line.split(",")[0] for line in capfd.readouterr().err.splitlines()]
    assert lines == [
        f"{stage}: {what}" for stage in ("detect", "track") for what in ("1 of 2 frames", "2 of 2 frames", "done")
    ]
    clock = iter((0.0, 80.0, 90.0, 110.0, 110.0))
    monkeypatch.setattr("pipelines.cli.console.time.monotonic", lambda: next(clock))
    with Console(interval=0.0).shares("search") as report:
        for share in (0.8, 0.9, 0.2):  # at last, work begins again
            report("round", share)
    assert capfd.readouterr().err.splitlines()[:3] == [
        "search: 80 of 100 %, about 20 s left, round",
        "search: 90 of 100 %, about 10 s left, round",
        "search: 20 of 100 %, about 440 s left, round",
    ]


# ---------------------------------------------------------------- failures


def _two_that_cause_each_other() -> Exception:
    first, second = ValueError("first"), FileError("cameras.yaml", "cam0.intrinsics is 5")
    first.__cause__, second.__context__ = second, first
    return second


def _a_wrapped_interrupt() -> Exception:
    error = RuntimeError("Error calling __set_name__")
    error.__cause__ = KeyboardInterrupt()
    return error


@pytest.mark.parametrize(
    ("error", "code", "words"),
    [
        (FileError("a.h5", "no HDF5 file"), 2, "a.h5: no HDF5 file"),
        (SolverError("no solution", count=2, total=9), 1, "no solution (2 of 9)"),
        (OSError(errno.ENOSPC, "No space", "x.h5"), 1, "x.h5: the disk is full"),
        (PermissionError(errno.EACCES, "Denied", "x.h5"), 1, "x.h5: no permission"),
        (MemoryError(), 1, "out of memory"),
        (KeyboardInterrupt(), 130, "interrupted"),
        (_a_wrapped_interrupt(), 130, "interrupted"),
        (ValueError("two\nlines"), 1, "this is a bug in tossid (ValueError: two lines)"),
        (_two_that_cause_each_other(), 2, "cameras.yaml: cam0.intrinsics is 5"),
    ],
)
def test_every_failure_is_one_line(
    failing: Callable[[BaseException], None],
    capfd: pytest.CaptureFixture[str],
    error: BaseException,
    code: int,
    words: str,
) -> None:
    failing(error)
    assert app.run(["info", "x", "--json"]) == code
    out, err = capfd.readouterr()
    assert out == ""
    assert words in one_line(err)
    assert one_line(err).startswith("tossid info: ")


def test_a_traceback_is_in_a_log_for_a_bug_and_shown_where_asked_for(
    failing: Callable[[BaseException], None], project: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    failing(RuntimeError("unthought of"))
    assert app.run(["info", "x"]) == 1
    (log,) = (project / failures.LOGS).iterdir()
    assert str(failures.LOGS / log.name) in capfd.readouterr().err
    assert "RuntimeError: unthought of" in log.read_text()
    assert "['info', 'x']" in log.read_text()
    failing(FileError("a.h5", "no HDF5 file"))
    assert app.run(["info", "x", "--debug"]) == 2
    err = capfd.readouterr().err
    assert "Traceback" in err
    assert err.strip().splitlines()[-1] == "tossid info: a.h5: no HDF5 file"


INTERRUPTED = """
import os, signal, sys, time
from pipelines.cli import app
from pipelines.cli import call as calling
from tossid.outputs import output_file
def write(path, console):
    with output_file(path.file) as temporary:
        temporary.write_text("half")
        os.kill(os.getpid(), getattr(signal, sys.argv[1]))
        time.sleep(30)
calling._runner = lambda command: write
sys.exit(app.run(["info", "a.h5"]))
"""


@pytest.mark.parametrize("number", ["SIGINT", "SIGTERM"])
def test_an_interrupted_command_tidies_up(project: Path, number: str) -> None:
    (project / "a.h5").write_text("old")
    done = subprocess.run([sys.executable, "-c", INTERRUPTED, number], capture_output=True, text=True, timeout=60)
    assert done.returncode == 130
    assert "interrupted" in one_line(done.stderr)
    assert (project / "a.h5").read_text() == "old"
    assert [path.name for path in project.iterdir()] == ["a.h5"]


def test_a_table_is_whole_and_its_names_are_not_wrapped(capfd: pytest.CaptureFixture[str]) -> None:
    head = [f"a_long_name_of_column_{k}" for k in range(5)]
    rows = [
        [f"a_long_name_of_row_{k}", -3.6e-15, 0.5, "many words one after another", "0123456789" * 6] for k in (0, 1)
    ]
    Console().table([*head[:-1], "tilt [deg]"], rows, title="tosses [a/b]")
    said = capfd.readouterr().err
    for name in (*head[:-1], "tilt [deg]", "tosses [a/b]", rows[0][0], rows[1][0]):
        assert name in said
    assert said.count("9") == 12
    assert "e-15" not in said
