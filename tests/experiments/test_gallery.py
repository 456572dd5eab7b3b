"""The gallery's page shows the figures that there are, under the calls that made them."""

from __future__ import annotations

import re

from experiments.gallery import FOLDER, PAGE, STEPS, _shown
from pipelines.cli.help import command_names
from pipelines.execution.code_version import ROOT


def test_a_call_is_shown_as_it_is_typed() -> None:
    assert _shown("evaluate", ("sweep=gravity", "sweep.train=['epochs=1']")) == (
        "tossid evaluate --sweep gravity \"sweep.train=['epochs=1']\""
    )


def test_the_page_and_its_pictures_belong_together() -> None:
    text = (ROOT / PAGE).read_text()
    shown = set(re.findall(r"\(gallery/([^)]+)\)", text))
    assert shown == {path.name for path in (ROOT / FOLDER).iterdir()}
    for title, command, _ in STEPS:
        assert command in command_names()
        assert not title or f"## {title}\n" in text
