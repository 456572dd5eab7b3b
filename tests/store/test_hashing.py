"""Hashes change with the content and the names, and with nothing else."""

from __future__ import annotations

import hashlib
import os
from pathlib import Path

import pytest

from tossid.errors import FileError
from tossid.store import file_sha256, source_sha256
from tossid.store.hashing import natural_key


def test_a_files_hash_is_sha256(tmp_path: Path) -> None:
    content = os.urandom(3_000_000)
    (tmp_path / "a").write_bytes(content)
    assert file_sha256(tmp_path / "a") == hashlib.sha256(content).hexdigest()
    assert source_sha256(tmp_path / "a") == file_sha256(tmp_path / "a")


def test_a_folders_hash_knows_names_and_contents(tmp_path: Path) -> None:
    def folder(name: str, files: dict[str, str]) -> str:
        for file, content in files.items():
            place = tmp_path / name / file
            place.parent.mkdir(parents=True, exist_ok=True)
            place.write_text(content)
        return source_sha256(tmp_path / name)

    base = folder("a", {"1.txt": "x", "deep/2.txt": "y"})
    assert folder("b", {"deep/2.txt": "y", "1.txt": "x"}) == base
    assert folder("c", {"1.txt": "x", "deep/2.txt": "z"}) != base
    assert folder("d", {"1.txt": "x", "deep/3.txt": "y"}) != base
    assert folder("e", {"1.txt": "x", "deep/2.txt": "y", "3.txt": ""}) != base


def test_names_are_hashed_in_sorted_order_whatever_they_are(tmp_path: Path) -> None:
    names = ["a/z", "a.x", "a-", "ab", "a/b/c", "a/b.d", "a/b/-", ".hidden/x", "Z", "é/1", "é0", "b/a", "a0"]
    for name in names:
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(name)
    (tmp_path / "link").symlink_to(tmp_path / "Z")
    (tmp_path / "elsewhere").symlink_to(tmp_path / "a")
    digest = hashlib.sha256()
    for name in sorted([*names, "link"]):  # what lies behind a linked folder is not the source's own
        digest.update(f"{file_sha256(tmp_path / name)}  {name}\n".encode())
    assert source_sha256(tmp_path) == digest.hexdigest()


def test_what_is_not_there_is_named(tmp_path: Path) -> None:
    with pytest.raises(FileError, match="nowhere"):
        file_sha256(tmp_path / "nowhere")
    with pytest.raises(FileError, match="nowhere"):
        source_sha256(tmp_path / "nowhere")


def test_two_comes_before_ten() -> None:
    names = ["10.pt", "2.pt", "1.pt", "toss_10", "toss_9", "a"]
    assert sorted(names, key=natural_key) == ["1.pt", "2.pt", "10.pt", "a", "toss_9", "toss_10"]
