"""The diagnosis of a case gets a dataset, and no more; its summary keeps what gained anything."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from tossid.diagnosis.audit.cases import Case
from tossid.diagnosis.audit.making import make_case
from tossid.diagnosis.audit.steps import Job, diagnose_withheld, summary_of
from tossid.objects import ObjectModel
from tossid.physics.effects import LIBRARY
from tossid.settings.diagnosis.audit import AuditSettings
from tossid.settings.diagnosis.diagnose import DiagnoseSettings


def finding(name: str, verdict: str, gain: float) -> dict[str, Any]:
    evidence = {"gain": gain, "p_value": 0.5, "n_tosses": 8.0}
    return {
        "name": name,
        "verdict": verdict,
        "evidence": evidence,
        "gap_closed": {"value": 0.1},
        "parameters": {},
        "frequency": 1.0,
    }


def test_a_summary_keeps_what_was_named_or_gained() -> None:
    effects = [finding("friction", "identified", 5.0), finding("gravity", "not_supported", 2.0)]
    effects.append(finding("magnus", "not_supported", -1.0))
    gap = {
        "gap": {"total": {"value": 5.0}, "noise_floor": 1.0},
        "gap_left": {"value": 1.1},
        "effects": effects,
        "explanation": {"gap_closed": {"value": 0.9}, "unexplained_where": []},
        "seconds": 1.0,
    }
    found = summary_of(gap)
    assert [each["name"] for each in found["findings"]] == ["friction", "gravity"]
    assert (found["total"], found["left"], found["gap_closed"]) == (5.0, 1.1, 0.9)


def test_a_job_is_named_by_its_number_and_digest(cube: ObjectModel) -> None:
    case = Case(3, "null", "lcp", (), (), 0)
    assert Job(case, cube, AuditSettings(), "0123456789abcdef").name == "003-01234567"


def test_the_search_is_repeated_as_often_as_asked(cube: ObjectModel, tmp_path: Path) -> None:
    make_case(Case(3, "effect", "lcp", ("gravity",), (40.0,), 11), cube, AuditSettings(tosses=8), tmp_path)
    others = [effect.name for effect in LIBRARY if effect.name not in ("gravity", "restitution")]
    found = diagnose_withheld(tmp_path / "tosses.h5", others, 0, DiagnoseSettings(repeats=1))
    assert found["explanation"]["repeats"] == 1
    (gravity,) = (each for each in found["effects"] if each["name"] == "gravity")
    assert gravity["frequency"] == 1.0


@pytest.mark.slow
def test_the_diagnosis_gets_a_dataset_and_no_more(cube: ObjectModel, tmp_path: Path) -> None:
    make_case(Case(3, "effect", "lcp", ("linear_drag",), (40.0,), 11), cube, AuditSettings(tosses=8), tmp_path)
    found = diagnose_withheld(tmp_path / "tosses.h5", ("linear_drag",), 0, DiagnoseSettings(repeats=0))
    assert "linear_drag" not in {finding["name"] for finding in found["effects"]}
    assert summary_of(found)["noise_floor"] > 0
