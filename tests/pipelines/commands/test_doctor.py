"""`tossid doctor` says what is there, what is not, and what to do."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from pipelines.commands import doctor


def findings(report: dict[str, Any]) -> dict[str, dict[str, str]]:
    return {finding["what"]: finding for finding in report["findings"]}


def test_where_all_is_well(project: Path, answer: Any) -> None:
    report = answer("doctor")
    assert report["ok"]
    found = findings(report)
    assert {"Python", "packages", "extra cluster", "machine", "this folder", "MLflow"} <= set(found)
    assert found["datasets"]["state"] == "optional"
    assert found["datasets"]["advice"] == "make one: tossid ingest"


def test_what_is_missing_is_named_with_what_to_do(project: Path, answer: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    needs = {"": ["numpy~=1.0", "no-such-package>=2"], "view": ["no-such-viewer~=1.0"]}
    monkeypatch.setattr(doctor, "_requirements", lambda: needs)
    monkeypatch.setenv("MLFLOW_TRACKING_URI", "http://127.0.0.1:9")
    report = answer("doctor")
    assert not report["ok"]
    found = findings(report)
    assert "no-such-package (needs >=2)" in found["packages"]["found"]
    assert "(needs ~=1.0)" in found["packages"]["found"]
    assert found["extra view"]["state"] == "optional"
    assert found["extra view"]["advice"].endswith("pip install -e '.[view]'")
    assert found["MLflow"]["state"] == "missing"
    assert "127.0.0.1:9: the tracking server does not answer" in found["MLflow"]["found"]
