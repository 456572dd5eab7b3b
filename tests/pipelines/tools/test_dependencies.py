"""Dependencies are checked in any case, and audited where the service can be reached."""

from __future__ import annotations

import subprocess
import sys
from typing import Any

import pytest

from pipelines.tools import dependencies


@pytest.fixture
def called(monkeypatch: pytest.MonkeyPatch) -> dict[str, Any]:
    """What is run, with statuses to answer with."""
    known: dict[str, Any] = {"pip": 0, "pip_audit": 0, "ran": []}

    def run(command: list[str], *, check: bool) -> subprocess.CompletedProcess[bytes]:
        assert command[:2] == [sys.executable, "-m"]
        known["ran"].append(command[2])
        return subprocess.CompletedProcess(command, known[command[2]])

    monkeypatch.setattr(dependencies.subprocess, "run", run)
    return known


class Reached:
    def close(self) -> None:
        pass


def test_what_does_not_fit_together_fails(called: dict[str, Any]) -> None:
    called["pip"] = 1
    assert dependencies.main() == 1
    assert called["ran"] == ["pip"]


@pytest.mark.parametrize("status", [0, 1])
def test_the_audit_decides(called: dict[str, Any], monkeypatch: pytest.MonkeyPatch, status: int) -> None:
    monkeypatch.setattr(dependencies.socket, "create_connection", lambda *_: Reached())
    called["pip_audit"] = status
    assert dependencies.main() == status
    assert called["ran"] == ["pip", "pip_audit"]


def test_a_service_out_of_reach_is_said(
    called: dict[str, Any], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def refuse(*_: object) -> None:
        raise OSError("no route")

    monkeypatch.setattr(dependencies.socket, "create_connection", refuse)
    assert dependencies.main() == 0
    assert called["ran"] == ["pip"]
    said = capsys.readouterr()
    assert "not audited: api.osv.dev cannot be reached" in said.out + said.err
