"""What the library reports of long work is shown stage by stage."""

from __future__ import annotations

import pytest

from pipelines.cli.console import Console
from pipelines.cli.progress import reported
from tossid.vision.progress import Progress, Reporter


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
