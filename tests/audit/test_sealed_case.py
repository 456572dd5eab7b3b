"""A diagnosis cannot see the truth of its case, and a finished case is known again."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from tests.audit.answers import answer
from tossid.audit import sealed_case
from tossid.audit.cases import Case
from tossid.audit.sealed_case import Job, read_case, run_case
from tossid.objects import ObjectModel
from tossid.settings.audit import AuditSettings

CASE = Case(7, "without", "lcp", ("wind",), (20.0,), 1004)


@pytest.fixture
def asked(monkeypatch: pytest.MonkeyPatch) -> list[Any]:
    """A case that is neither simulated nor diagnosed; returns what diagnoses were asked for."""
    calls: list[Any] = []

    def diagnosed(data: Path, without: Any, seed: int, repeats: int) -> dict[str, Any]:
        calls.append((sorted(path.name for path in data.parent.iterdir()), without, seed, repeats))
        return answer(verdict="no_gap")

    truth = {"case": CASE.as_json(), "effects": {"wind": {"x_ms": 2.0}}, "displacement": {"wind": 19.0}}
    monkeypatch.setattr(sealed_case, "make_case", lambda *args: truth)
    monkeypatch.setattr(sealed_case, "diagnose_withheld", diagnosed)
    return calls


def test_a_case_is_diagnosed_without_its_truth_and_known_again_by_its_digest(
    cube: ObjectModel, asked: list[Any], tmp_path: Path
) -> None:
    job = Job(CASE, cube, AuditSettings(repeats=3), "a1b2c3d4" + 56 * "0")
    assert read_case(tmp_path, job) is None
    run_case(job, tmp_path)
    ((files, without, seed, repeats),) = asked
    assert files == ["seal.txt"]
    assert {"wind", "linear_drag"} <= set(without)
    assert (seed, repeats) == (4, 3)
    done = read_case(tmp_path, job)
    assert done is not None
    assert done["truth"]["effects"] == {"wind": {"x_ms": 2.0}}
    assert done["gap"] == answer(verdict="no_gap")
    assert read_case(tmp_path, replace(job, digest="a1b2c3d4" + 56 * "1")) is None
    (tmp_path / "cases" / job.name / "gap.json").write_text("{")
    assert read_case(tmp_path, job) is None
