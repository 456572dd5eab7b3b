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
