"""The command line keeps its promises: streams, exit codes, one clear line."""

from __future__ import annotations

import errno
import json
import os
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from pipelines.cli import app, failures
from pipelines.cli import call as calling
from pipelines.cli.console import Console
from pipelines.cli.help import command_names
from tests.pipelines.conftest import Run, one_line
from tossid.errors import FileError, SolverError


@pytest.fixture
def command(project: Path, monkeypatch: pytest.MonkeyPatch) -> SimpleNamespace:
    """`tossid info FILE`, with what it does replaced by `.does`."""
    stand_in = SimpleNamespace(does=lambda path, console: {})
    monkeypatch.setattr(calling, "_runner", lambda command: lambda path, console: stand_in.does(path, console))
    return stand_in


@pytest.mark.parametrize(
    ("args", "words"),
    [
        (["ingest", "soruce=tum"], "Did you mean 'source'?"),
        (["ingest", "source=tom"], "Did you mean 'tum'?"),
        (["ingest", "seed=x"], "expected a whole number"),
        (["ingest", "+seed=1"], "cannot be added"),
        (["ingest", "~seed"], "cannot be removed"),
        (["ingest", "tum"], "Did you mean 'source=tum'?"),
        (["ingest", "source=tum"], "source.path: is needed"),
        (["ingest", "--seed", "3"], "seed=…"),
        (["ingest", "--jsn"], "Did you mean '--json'?"),
        (["ingset"], "Did you mean 'ingest'?"),
        (["info"], "FILE"),
        (["info", "nowhere.h5"], "nowhere.h5: no such file"),
        (["--nothing"], "--nothing"),
        (["ingest"], "no recording here"),
        (
            ["ingest", "source=tum", "source.path=nowhere"],
            "nowhere: no such file or folder; source.path names",
        ),
    ],
)
def test_a_wrong_call_is_one_line_and_exit_2(
    project: Path, capfd: pytest.CaptureFixture[str], args: list[str], words: str
) -> None:
    assert app.run(args) == 2
    out, err = capfd.readouterr()
    assert out == ""
    assert words in one_line(err)
    assert "Traceback" not in err


def test_help_names_every_command(tossid: Run) -> None:
    done = tossid("--help")
    assert done.returncode == 0
    for name in command_names():
        assert name in done.stdout


@pytest.mark.parametrize("name", command_names())
def test_help_lists_keys_with_units(tossid: Run, name: str) -> None:
    done = tossid(name, "--help")
    assert done.returncode == 0
    assert done.stderr == ""
    if name == "ingest":
        for words in ("source=", "contactnets", "source.half_width", "0.0524", "[m]", "[m/s²]"):
            assert words in done.stdout


def test_help_imports_nothing_heavy(project: Path) -> None:
    script = (
        "import sys\nfrom pipelines.cli import app\n"
        "code = app.run(sys.argv[1:])\n"
        "heavy = {'hydra', 'omegaconf', 'mlflow', 'torch', 'numpy', 'numba', 'cv2', 'h5py', 'mujoco'}\n"
        "heavy &= set(sys.modules)\n"
        "sys.exit(f'imported {heavy}' if heavy or code else 0)"
    )
    for args in (["--help"], ["train", "--help"], ["diagnose", "--help"], ["ingest", "--help"]):
        done = subprocess.run([sys.executable, "-c", script, *args], capture_output=True, text=True, timeout=60)
        assert done.returncode == 0, done.stderr


def test_json_is_all_there_is_on_standard_output(command: SimpleNamespace, capfd: pytest.CaptureFixture[str]) -> None:
    import numpy as np

    def noisy(path: Path, console: Console) -> dict[str, Any]:
        print("a library's chatter")
        os.write(1, b"a C library's chatter\n")
        subprocess.run(["echo", "a child's chatter"], check=True)
        console.say("for people")
        console.table(["name", "value"], [["a", 1.0]])
        console.warn("careful")
        return {"path": path, "mean": np.float64(2.5), "bad": float("nan"), "list": np.arange(3), "flag": np.True_}

    command.does = noisy
    assert app.run(["info", "x", "--json"]) == 0
    out, err = capfd.readouterr()
    assert json.loads(out) == {"path": "x", "mean": 2.5, "bad": None, "list": [0, 1, 2], "flag": True}
    for words in (
        "a library's chatter",
        "a C library's chatter",
        "a child's chatter",
        "for people",
        "warning: careful",
    ):
        assert words in err
    assert app.run(["info", "x"]) == 0
    assert capfd.readouterr().out == ""


def test_quiet_leaves_warnings_only(command: SimpleNamespace, capfd: pytest.CaptureFixture[str]) -> None:
    def talk(path: Path, console: Console) -> dict[str, Any]:
        console.say("news")
        with console.progress("work", 3) as progress:
            progress.advance(3)
        console.warn("careful")
        return {}

    command.does = talk
    assert app.run(["info", "x", "--quiet"]) == 0
    assert capfd.readouterr().err == "warning: careful\n"


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


def test_plain_progress_lines_come_now_and_then(capfd: pytest.CaptureFixture[str]) -> None:
    console = Console(interval=0.0)
    with console.progress("detect", 4, unit="frames") as progress:
        for _ in range(4):
            progress.advance(note="2 tags")
    lines = capfd.readouterr().err.splitlines()
    assert lines[0].startswith("detect: 1 of 4 frames")
    assert "2 tags" in lines[0]
    assert lines[-1].startswith("detect: done, 4 of 4 frames")
    with Console().progress("detect", 4) as progress:
        progress.advance(4)
    assert capfd.readouterr().err == ""  # too quick to speak of


def test_version(tossid: Run) -> None:
    assert tossid("--version").stdout.startswith("tossid 0.")


@pytest.mark.parametrize("number", ["SIGINT", "SIGTERM"])
def test_an_interrupted_command_tidies_up(project: Path, number: str) -> None:
    script = f"""
import os, signal, sys
from pathlib import Path
from pipelines.cli import app
from pipelines.cli import call as calling
from tossid.outputs import output_file
def write(path, console):
    with output_file(path) as temporary:
        temporary.write_text("half")
        os.kill(os.getpid(), signal.{number})
        import time; time.sleep(30)
calling._runner = lambda command: write
sys.exit(app.run(["info", "a.h5"]))
"""
    (project / "a.h5").write_text("old")
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, cwd=project, timeout=60)
    assert done.returncode == 130
    assert "interrupted" in one_line(done.stderr)
    assert (project / "a.h5").read_text() == "old"
    assert [path.name for path in project.iterdir()] == ["a.h5"]
