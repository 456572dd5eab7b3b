"""Wrong calls are one line; the result alone is on standard output; what a person sees is on standard error."""

from __future__ import annotations

import json
import logging
import os
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from pipelines.cli import app
from pipelines.cli.console import Console
from pipelines.cli.progress import reported
from tests.pipelines.conftest import Run, one_line
from tossid.ingestion.progress import Progress, Reporter


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
        (["--version", "--quiet"], "--quiet: no such option. It stands after a command: tossid COMMAND --quiet."),
        (["-q"], "-q: no such option. It stands after a command: tossid COMMAND -q."),
        (["--versoin"], "Did you mean '--version'?"),
        (["info", "--version"], "It stands alone: tossid --version."),
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


def test_version(tossid: Run) -> None:
    assert tossid("--version").stdout.startswith("tossid 0.")


def test_json_is_all_there_is_on_standard_output(command: SimpleNamespace, capfd: pytest.CaptureFixture[str]) -> None:
    import numpy as np

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


@pytest.mark.parametrize("number", ["SIGINT", "SIGTERM"])
def test_an_interrupted_command_tidies_up(project: Path, number: str) -> None:
    script = f"""
import os, signal, sys
from pathlib import Path
from pipelines.cli import app
from pipelines.cli import call as calling
from tossid.outputs import output_file
def write(path, console):
    with output_file(path.file) as temporary:
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


def test_what_the_library_logs_is_said_once(command: SimpleNamespace, capfd: pytest.CaptureFixture[str]) -> None:
    def logs(path: Any, console: Console) -> dict[str, Any]:
        for _ in range(2):
            logging.getLogger("tossid.objects").info("thing.xml states friction 0.9")
            logging.getLogger("tossid.objects").warning("0.18 is a guess")
        logging.getLogger("elsewhere").warning("not ours")
        return {}

    command.does = logs
    assert app.run(["info", "x"]) == 0
    said = capfd.readouterr().err
    assert (said.count("thing.xml states"), said.count("warning: 0.18 is"), said.count("0.18 is")) == (1, 1, 1)
    assert app.run(["info", "x", "--quiet"]) == 0
    said = capfd.readouterr().err
    assert (said.count("thing.xml states"), said.count("0.18 is")) == (0, 1)
    assert not logging.getLogger("tossid").handlers


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


def test_work_that_begins_again_is_estimated_anew(
    capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    clock = iter((0.0, 80.0, 82.0, 90.0, 100.0, 110.0, 110.0))
    monkeypatch.setattr("pipelines.cli.console.time.monotonic", lambda: next(clock))
    with Console(interval=0.0).shares("search") as report:
        for share in (0.8, 0.75, 0.9, 0.2, 0.4):
            report("round", share)
    lines = capfd.readouterr().err.splitlines()
    assert lines[0] == "search: 80 of 100 %, about 20 s left, round"
    assert lines[1].startswith("search: 80 of 100 %")  # a little less is no beginning
    assert lines[2] == "search: 90 of 100 %, about 10 s left, round"
    assert lines[3] == "search: 20 of 100 %, round"  # at no known pace
    assert lines[4] == "search: 40 of 100 %, about 30 s left, round"


def test_messages_are_lines_and_problems_are_warnings(capsys: pytest.CaptureFixture[str]) -> None:
    with reported(Console()) as show:
        show(Progress("detect", message="12 images"))
        show(Progress("detect", message="one is broken", is_problem=True))
    assert capsys.readouterr().err.splitlines() == ["12 images", "warning: one is broken"]


def test_each_stage_that_counts_has_a_bar_of_its_own(capsys: pytest.CaptureFixture[str]) -> None:
    with reported(Console(interval=0.0)) as show:
        for stage in ("detect", "track"):
            for _ in range(2):
                show(Progress(stage, done=1, total=2, unit="frames"))
    lines = capsys.readouterr().err.splitlines()
    assert [line.split(",")[0] for line in lines] == [
        "detect: 1 of 2 frames",
        "detect: 2 of 2 frames",
        "detect: done",
        "track: 1 of 2 frames",
        "track: 2 of 2 frames",
        "track: done",
    ]


def test_the_library_reports_through_it(capsys: pytest.CaptureFixture[str]) -> None:
    with reported(Console(quiet=True)) as show:
        Reporter(show)
    assert capsys.readouterr().err == ""
