"""`make setup` says how far it is while pip works, and gives pip's exit status on."""

from __future__ import annotations

import runpy
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

SCRIPT = Path(__file__).parents[2] / "requirements" / "install.py"


@pytest.mark.parametrize("status", [0, 3])
def test_a_slow_installation_is_reported(status: int, monkeypatch: pytest.MonkeyPatch, capfd: Any) -> None:
    script = runpy.run_path(str(SCRIPT))["main"]
    asked = []
    begin = subprocess.Popen

    def slow(command: list[str]) -> subprocess.Popen[bytes]:
        asked.append(command)
        return begin([sys.executable, "-c", f"import time; time.sleep(0.5); raise SystemExit({status})"])

    monkeypatch.setitem(script.__globals__, "EVERY_S", 0.05)
    monkeypatch.setitem(script.__globals__, "megabytes", lambda: 7.0)
    monkeypatch.setattr(subprocess, "Popen", slow)
    assert script(["torch"]) == status
    assert asked[0][-3:] == ["install", "--quiet", "torch"]
    lines = capfd.readouterr().err.splitlines()
    assert lines[0].startswith("installing packages: 0 MB in")
    assert lines[-1].startswith("installed 0 MB in" if status == 0 else "installing packages")
