"""The truth is sealed before the diagnosis: unreadable, elsewhere, and known by its hash."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path

import pytest

from tossid.audit.sealing import seal, unseal
from tossid.errors import FileError


def test_the_seal_is_the_hash_of_the_truth_and_gives_nothing_away(tmp_path: Path) -> None:
    truth = {"case": {"index": 3}, "effects": {"linear_drag": {"c_nspm": 0.1}}}
    hashes = []
    for name in ("one", "other"):
        unseal(seal(truth, name, tmp_path, tmp_path), tmp_path)
        content = (tmp_path / "truth.json").read_bytes()
        hashes.append(hashlib.sha256(content).hexdigest())
        assert hashes[-1] == (tmp_path / "seal.txt").read_text().strip()
        assert {k: v for k, v in json.loads(content).items() if k != "nonce"} == truth
    assert hashes[0] != hashes[1]  # the nonce: nobody finds a short truth by trying


def test_the_truth_lies_unreadable_elsewhere_until_it_is_unsealed(tmp_path: Path) -> None:
    folder = tmp_path / "case"
    folder.mkdir()
    path = seal({"effects": {"magnus": {"c_ns2pm": 0.02}}}, "003-01234567", tmp_path, folder)
    assert path.stat().st_mode & 0o777 == 0
    assert [p.name for p in folder.iterdir()] == ["seal.txt"]
    sha256 = (folder / "seal.txt").read_text().strip()
    assert f"003-01234567 {sha256}" in (tmp_path / "seals.txt").read_text()
    unseal(path, folder)
    truth = json.loads((folder / "truth.json").read_text())
    assert truth["effects"] == {"magnus": {"c_ns2pm": 0.02}}
    assert hashlib.sha256((folder / "truth.json").read_bytes()).hexdigest() == sha256


def test_a_truth_that_was_changed_is_refused(tmp_path: Path) -> None:
    path = seal({"effects": {}}, "a", tmp_path, tmp_path)
    path.chmod(0o600)
    path.write_text('{"effects": {"gravity": {"g_ms2": 9.0}}}')
    with pytest.raises(FileError, match="is not what was sealed"):
        unseal(path, tmp_path)
