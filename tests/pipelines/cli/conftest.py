"""A command that does what a test says."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

import pytest

from pipelines.cli import call as calling


@pytest.fixture
def command(project: Path, monkeypatch: pytest.MonkeyPatch) -> SimpleNamespace:
    """`tossid info FILE`, with what it does replaced by `.does`."""
    stand_in = SimpleNamespace(does=lambda path, console: {})
    monkeypatch.setattr(calling, "_runner", lambda command: lambda path, console: stand_in.does(path, console))
    return stand_in
