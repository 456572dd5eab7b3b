"""A project folder of its own for each test, and the command line as a stranger runs it."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

Run = Callable[..., "subprocess.CompletedProcess[str]"]


@pytest.fixture
def project(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty working folder, with MLflow's own defaults."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("MLFLOW_TRACKING_URI", raising=False)
    return tmp_path


@pytest.fixture
def tossid(project: Path) -> Run:
    """Run `tossid ARGS` in a process of its own, in the project folder."""

    def run(*args: str) -> subprocess.CompletedProcess[str]:
        return subprocess.run(
            [sys.executable, "-m", "pipelines.app", *args], capture_output=True, text=True, cwd=project, timeout=120
        )

    return run


def one_line(text: str) -> str:
    """The single line of an error report; fails where there are more."""
    lines = text.strip().splitlines()
    assert len(lines) == 1, text
    return lines[0]
