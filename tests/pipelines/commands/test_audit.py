"""`tossid audit` as it is called: cases appear whole, finished ones are kept."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path
from typing import Any

import pytest


@pytest.mark.slow
def test_an_audit_end_to_end_and_again(project: Path, answer: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    keys = ["audit", "tosses=8", "workers=2", "engines=[lcp]", "out=o"]
    first = answer(*keys, "cases=1")
    assert first["failed"] == {}
    (folder,) = (project / "o/cases").glob("0*")
    assert {p.name for p in folder.iterdir()} >= {"tum", "tosses.h5", "seal.txt", "truth.json", "gap.json"}
    sealed = (folder / "seal.txt").read_text().strip()
    assert hashlib.sha256((folder / "truth.json").read_bytes()).hexdigest() == sealed
    assert sealed in (project / "o/seals.txt").read_text()
    before = (folder / "result.json").stat().st_mtime_ns
    second = answer(*keys, "cases=2")
    assert (folder / "result.json").stat().st_mtime_ns == before
    assert second["cases"][0]["name"] == first["cases"][0]["name"]
    assert [row["kind"] for row in second["cases"]] == ["null", "effect"]
    assert {Path(path).name for path in second["figures"]} == {"detection.png"}
    assert json.loads((project / "o/audit.json").read_text())["summary"] == second["summary"]
