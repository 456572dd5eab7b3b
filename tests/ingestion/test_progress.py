"""Reports reach the callback; without one, problems are warnings."""

from __future__ import annotations

import pytest

from tossid.ingestion.progress import IngestWarning, Progress, Reporter


def test_a_callback_gets_steps_messages_and_problems() -> None:
    seen: list[Progress] = []
    report = Reporter(seen.append)
    advance = report.counter("detect", 10, "images")
    advance(4)
    report.message("detect", "done")
    report.problem("track", "a clock is late")
    assert seen == [
        Progress("detect", 0, 10, "images"),
        Progress("detect", 4, 10, "images"),
        Progress("detect", message="done"),
        Progress("track", message="a clock is late", is_problem=True),
    ]
    assert report.problems == ["a clock is late"]


def test_without_a_callback_problems_are_warnings() -> None:
    report = Reporter()
    report.counter("detect", None, "images")(3)
    report.message("detect", "nobody reads this")
    with pytest.warns(IngestWarning, match="a clock is late"):
        report.problem("track", "a clock is late")
    assert report.problems == ["a clock is late"]
