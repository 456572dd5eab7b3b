"""An audit keeps what is done, reports what failed, and gives each step to whoever computes it."""

from __future__ import annotations

import json
from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from tossid.diagnosis.audit import steps
from tossid.diagnosis.audit.run import audit, in_this_process, plan, stored
from tossid.diagnosis.audit.steps import Job
from tossid.errors import ConfigError, InputError, SolverError
from tossid.objects import ObjectModel
from tossid.parallel import as_done
from tossid.settings.diagnosis.audit import AuditSettings, ScoreSettings

SETTINGS = AuditSettings(cases=3, tosses=6, engines=("lcp",))


def gap(*named: str) -> dict[str, Any]:
    """gap.json, as far as an audit reads it."""
    return {
        "gap": {"by_phase": [{"phase": "slide", "share": 1.0}], "total": {"value": 5.0}, "noise_floor": 1.0},
        "gap_left": {"value": 1.1},
        "effects": [],
        "explanation": {
            "verdict": "explained",
            "effects": list(named),
            "gap_closed": {"value": 0.9},
            "unexplained_where": [],
        },
        "seconds": 1.0,
    }


@pytest.fixture
def quick(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Steps without computation; returns the jobs that were made."""
    made: list[str] = []

    def make(job: Job, folder: Path) -> dict[str, Any]:
        made.append(job.name)
        if job.case.index == 2:
            raise SolverError("did not converge", count=1, total=1)
        return {"case": job.case.as_json(), "effects": {}, "displacement": {}}

    monkeypatch.setattr(steps, "make", make)
    monkeypatch.setattr(steps, "diagnose", lambda job, folder: gap())
    monkeypatch.setattr(steps, "closable_share", lambda *args, **keys: 1.0)
    monkeypatch.setattr(steps, "read_case_tosses", lambda path: ((), None))
    return made


def test_done_cases_are_kept_and_failed_ones_are_tried_again(
    cube: ObjectModel, quick: list[str], tmp_path: Path
) -> None:
    reports: list[tuple[str, float]] = []
    first = audit(cube, out=tmp_path, settings=SETTINGS, progress=lambda *each: reports.append(each))
    assert len(first.rows) == 2
    (problem,) = first.failed.values()
    assert "did not converge" in problem
    assert reports[-1][1] == 1.0
    assert len(quick) == 3
    second = audit(cube, out=tmp_path, settings=SETTINGS)
    assert second.rows == first.rows
    assert len(quick) == 4  # the failed one, again
    folder = tmp_path / "cases" / first.rows[0]["name"]
    assert {path.name for path in folder.iterdir()} >= {"seal.txt", "truth.json", "gap.json", "result.json"}


def test_every_step_goes_to_a_worker(cube: ObjectModel, quick: list[str], tmp_path: Path) -> None:
    given: list[str] = []

    def submit(function: Callable[..., Any], *args: Any) -> Future[Any]:
        given.append(getattr(function, "__name__", "?"))
        return in_this_process(function, *args)

    audit(cube, out=tmp_path, settings=replace(SETTINGS, cases=1), submit=submit)
    assert given == ["make", "<lambda>", "score_case"]


def test_an_audit_without_a_result_is_an_error(cube: ObjectModel, tmp_path: Path) -> None:
    def refused(function: Callable[..., Any], jobs: Any) -> Any:
        return ((job, InputError("no")) for job in jobs)

    with pytest.raises(InputError, match="all 3 cases failed; the first: no"):
        audit(cube, out=tmp_path, settings=SETTINGS, each=refused)


def test_bad_settings_are_refused(cube: ObjectModel, elbow: ObjectModel, tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="is empty"):
        audit(elbow, out=tmp_path, engines=())
    with pytest.raises(ConfigError, match="single bodies"):
        audit(elbow, out=tmp_path, data=tmp_path / "real.h5")
    with pytest.raises(ConfigError, match="recorded already"):
        audit(cube, out=tmp_path, data=tmp_path / "real.h5", filmed=True)
    with pytest.raises(ConfigError, match="no tags"):
        audit(replace(cube, tags=()), out=tmp_path, filmed=True)


def test_a_case_is_known_again_by_all_that_it_depends_on(cube: ObjectModel, tmp_path: Path) -> None:
    job = plan(cube, SETTINGS)[0]
    folder = tmp_path / "cases" / job.name
    folder.mkdir(parents=True)
    (folder / "result.json").write_text(json.dumps({"digest": job.digest, "x": 1}))
    assert stored(tmp_path, job) == {"digest": job.digest, "x": 1}
    assert stored(tmp_path, replace(job, digest=job.digest[:8] + "f" * 56)) is None
    (folder / "result.json").write_text("{")
    assert stored(tmp_path, job) is None


def test_digests_follow_the_object_the_settings_and_the_code(cube: ObjectModel) -> None:
    plain = plan(cube, SETTINGS)[0].digest
    assert plan(cube, replace(SETTINGS, cases=9))[0].digest == plain  # a longer audit begins with the same cases
    others = [
        plan(cube.with_changes(friction=0.2), SETTINGS),
        plan(cube, replace(SETTINGS, tosses=7)),
        plan(cube, replace(SETTINGS, filmed=True)),
        plan(cube, replace(SETTINGS, scoring=ScoreSettings(restored=0.1))),
        plan(cube, SETTINGS, code="other"),
    ]
    assert len({plain, *(jobs[0].digest for jobs in others)}) == 6


def test_jobs_one_by_one_end_in_results_or_errors(cube: ObjectModel) -> None:
    def odd(job: Job) -> dict[str, Any]:
        if job.case.index == 1:
            raise InputError("odd")
        return {"index": job.case.index}

    found = [outcome for _, outcome in as_done(odd, plan(cube, SETTINGS))]
    assert found[0] == {"index": 0}
    assert isinstance(found[1], InputError)
    assert found[2] == {"index": 2}
