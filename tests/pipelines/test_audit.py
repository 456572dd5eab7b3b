"""`tossid audit` as it is called: truth is sealed before the diagnosis, cases appear whole, finished ones are kept."""

from __future__ import annotations

import hashlib
import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from pipelines import app, audit
from pipelines.audit import _seal, _stored, _unseal, seal
from pipelines.audit_case import Job, diagnose_case, make_case
from pipelines.config import load
from pipelines.schemas import AuditConfig
from tests.pipelines.conftest import one_line
from tossid.diagnosis.audit import Case
from tossid.errors import FileError
from tossid.store import read_dataset

CASE = Case(3, "effect", "lcp", ("linear_drag",), (40.0,), 11)


def job(*keys: str) -> Job:
    return Job(CASE, load("audit", AuditConfig, keys), "0123456789abcdef")


def test_the_seal_is_the_hash_of_the_truth_and_gives_nothing_away() -> None:
    truth = {"case": CASE.as_json(), "effects": {"linear_drag": {"c_nspm": 0.1}}}
    one, other = seal(truth), seal(truth)
    assert one[1] == hashlib.sha256(one[0]).hexdigest()
    assert one[1] != other[1]  # the nonce: nobody finds a short truth by trying
    assert {k: v for k, v in json.loads(one[0]).items() if k != "nonce"} == truth


def test_the_truth_lies_unreadable_elsewhere_until_it_is_unsealed(tmp_path: Path) -> None:
    folder = tmp_path / "case"
    folder.mkdir()
    path = _seal({"effects": {"magnus": {"c_ns2pm": 0.02}}}, job(), tmp_path, folder)
    assert path.stat().st_mode & 0o777 == 0
    assert [p.name for p in folder.iterdir()] == ["seal.txt"]
    sha256 = (folder / "seal.txt").read_text().strip()
    assert sha256 in (tmp_path / "seals.txt").read_text()
    truth = _unseal(path, folder)
    assert truth["effects"] == {"magnus": {"c_ns2pm": 0.02}}
    assert hashlib.sha256((folder / "truth.json").read_bytes()).hexdigest() == sha256


def test_a_truth_that_was_changed_is_refused(tmp_path: Path) -> None:
    path = _seal({"effects": {}}, job(), tmp_path, tmp_path)
    path.chmod(0o600)
    path.write_text('{"effects": {"gravity": {"g_ms2": 9.0}}}')
    with pytest.raises(FileError, match="is not what was sealed"):
        _unseal(path, tmp_path)


def test_what_the_diagnosis_gets_came_through_tum_files_and_does_not_name_the_effect(project: Path) -> None:
    truth = make_case(job("tosses=6"), project)
    assert truth["effects"]["linear_drag"]["c_nspm"] > 0
    assert 30 < truth["displacement"]["linear_drag"] < 55
    assert len(list((project / "tum").glob("*.txt"))) == 6
    dataset = read_dataset(project / "tosses.h5")
    assert dataset.source == "tum"
    assert all(toss.q_cov[5, 0, 0] > 1e-9 for toss in dataset.tosses)  # noise as it is estimated from the poses
    everything = b"".join(path.read_bytes() for path in project.rglob("*") if path.is_file())
    assert b"linear_drag" not in everything
    assert b"c_nspm" not in everything


def test_a_case_is_known_again_by_all_that_it_depends_on(tmp_path: Path) -> None:
    folder = tmp_path / "cases" / job().name
    folder.mkdir(parents=True)
    (folder / "result.json").write_text(json.dumps({"digest": job().digest, "x": 1}))
    assert _stored(tmp_path, job()) == {"digest": job().digest, "x": 1}
    assert _stored(tmp_path, replace(job(), digest="01234567ffffffff")) is None
    (folder / "result.json").write_text("{")
    assert _stored(tmp_path, job()) is None


def test_only_simulators_of_single_bodies_are_spoilt(project: Path, capfd: pytest.CaptureFixture[str]) -> None:
    assert app.run(["audit", "object=elbow", "cases=1", "data=elbow.h5"]) == 2
    assert "data" in one_line(capfd.readouterr().err)
    assert not (project / "outputs/audit").exists()


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
    assert {Path(path).name for path in second["figures"]} == {"confusion.png", "detection.png"}
    assert json.loads((project / "o/audit.json").read_text())["summary"] == second["summary"]


@pytest.mark.slow
def test_the_diagnosis_is_told_a_dataset_and_no_more(project: Path) -> None:
    make_case(job("tosses=8"), project)
    gap = diagnose_case(project / "tosses.h5", ("linear_drag",), 0)
    assert "linear_drag" not in {finding["name"] for finding in gap["effects"]}
    assert audit._short(gap)["noise_floor"] > 0
