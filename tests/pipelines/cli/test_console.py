"""What a person sees of a command, on standard error."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from pipelines.cli import app
from pipelines.cli.console import Console


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
