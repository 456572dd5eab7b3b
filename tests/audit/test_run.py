"""An audit keeps what is done, reports what failed, and no diagnosis sees the truth of its case."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from tests.audit.answers import answer
from tossid.audit import sealed_case
from tossid.audit.cases import Case
from tossid.audit.run import audit, plan
from tossid.audit.sealed_case import Job, read_case, run_case
from tossid.audit.sealing import seal, unseal
from tossid.errors import ConfigError, FileError, InputError, SolverError
from tossid.objects import ObjectModel
from tossid.settings.audit import AuditSettings

SETTINGS = AuditSettings(cases=3, tosses=6, engines=("lcp",))


@pytest.fixture
def quick(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """Cases without computation, of which one fails; returns the numbers of those that were made."""
    made: list[int] = []

    def make(case: Any, model: ObjectModel, settings: AuditSettings, folder: Path) -> dict[str, Any]:
        made.append(case.index)
        if case.index == 2:
            raise SolverError("did not converge", count=1, total=1)
        return {"case": case.as_json(), "effects": {}, "displacement": {}}

    def diagnosed(data: Path, *args: Any) -> dict[str, Any]:
        assert not (data.parent / "truth.json").exists()
        return answer(verdict="no_gap")

    monkeypatch.setattr(sealed_case, "make_case", make)
    monkeypatch.setattr(sealed_case, "diagnose_withheld", diagnosed)
    return made


def test_done_cases_are_kept_and_failed_ones_are_tried_again(
    cube: ObjectModel, quick: list[int], tmp_path: Path
) -> None:
    reports: list[tuple[str, float]] = []
    first = audit(cube, out=tmp_path, settings=SETTINGS, progress=lambda *each: reports.append(each))
    assert len(first.rows) == 2
    (problem,) = first.failed.values()
    assert "did not converge" in problem
    assert reports[-1][1] == 1.0
    second = audit(cube, out=tmp_path, settings=SETTINGS)
    assert second.rows == first.rows
    assert quick == [0, 1, 2, 2]
    folder = tmp_path / "cases" / first.rows[0]["name"]
    assert {path.name for path in folder.iterdir()} >= {"seal.txt", "truth.json", "gap.json", "result.json"}


def test_every_case_goes_to_a_worker(cube: ObjectModel, quick: list[int], tmp_path: Path) -> None:
    given: list[int] = []

    def submit(function: Callable[..., Any], job: Any) -> Future[Any]:
        given.append(job.case.index)
        future: Future[Any] = Future()
        future.set_result(function(job))
        return future

    audit(cube, out=tmp_path, settings=replace(SETTINGS, cases=2), submit=submit)
    assert given == quick == [0, 1]


def test_an_audit_without_a_result_is_an_error(
    cube: ObjectModel, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refused(*args: Any) -> None:
        raise InputError("no")

    monkeypatch.setattr(sealed_case, "make_case", refused)
    with pytest.raises(InputError, match="all 3 cases failed; the first: no"):
        audit(cube, out=tmp_path, settings=SETTINGS)


def test_bad_settings_are_refused(cube: ObjectModel, elbow: ObjectModel, tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="is empty"):
        audit(elbow, out=tmp_path, engines=())
    with pytest.raises(ConfigError, match="no tags"):
        audit(replace(cube, tags=()), out=tmp_path, filmed=True)


def test_digests_follow_the_object_the_settings_and_the_code(cube: ObjectModel) -> None:
    plain = plan(cube, SETTINGS)[0].digest
    assert plan(cube, replace(SETTINGS, cases=9))[0].digest == plain  # a longer audit begins with the same cases
    others = [
        plan(cube.with_changes(friction=0.2), SETTINGS),
        plan(cube, replace(SETTINGS, tosses=7)),
        plan(cube, replace(SETTINGS, filmed=True)),
        plan(cube, replace(SETTINGS, repeats=0)),
        plan(cube, SETTINGS, code="other"),
    ]
    assert len({plain, *(jobs[0].digest for jobs in others)}) == 6


def test_a_seed_has_the_cases_that_it_had_when_its_figures_were_measured(cube: ObjectModel) -> None:
    """The first cases of `cases=120 seed=139` of the audit's page; drawing them needs no engine but its name."""
    engines = ("lcp", "mujoco", "bullet", "drake")
    settings = replace(SETTINGS, cases=2, seed=139, engines=engines, displacement=(1.0, 300.0))
    cases = [job.case for job in plan(cube, settings)]
    assert [(case.kind, case.engine, case.effects, case.seed) for case in cases] == [
        ("effect", "lcp", ("geometry",), 186616157),
        ("pair", "lcp", ("vortex", "compliance"), 2596311643),
    ]
    assert cases[0].targets == (30.175690937960372,)


# ---------------------------------------------------------------- sealed cases


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


def test_a_truth_lies_unreadable_elsewhere_until_it_is_unsealed_and_is_known_by_its_hash(tmp_path: Path) -> None:
    truth, hashes = {"effects": {"magnus": {"c_ns2pm": 0.02}}}, []
    for name in ("one", "other"):
        folder = tmp_path / name
        folder.mkdir()
        path = seal(truth, name, tmp_path, folder)
        assert path.stat().st_mode & 0o777 == 0
        assert [p.name for p in folder.iterdir()] == ["seal.txt"]
        hashes.append((folder / "seal.txt").read_text().strip())
        assert f"{name} {hashes[-1]}" in (tmp_path / "seals.txt").read_text()
        unseal(path, folder)
        content = (folder / "truth.json").read_bytes()
        assert hashlib.sha256(content).hexdigest() == hashes[-1]
        assert {k: v for k, v in json.loads(content).items() if k != "nonce"} == truth
    assert hashes[0] != hashes[1]  # the nonce: nobody finds a short truth by trying
    path = seal({"effects": {}}, "a", tmp_path, tmp_path)
    path.chmod(0o600)
    path.write_text('{"effects": {"gravity": {"g_ms2": 9.0}}}')
    with pytest.raises(FileError, match="is not what was sealed"):
        unseal(path, tmp_path)
