"""Version and commit of the code, in a clone and outside one."""

from __future__ import annotations

import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest

from pipelines.execution import code_version
from pipelines.execution.code_version import commit, version, version_line


@pytest.fixture
def root(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A folder in the place of the clone."""
    monkeypatch.setattr(code_version, "ROOT", tmp_path)
    commit.cache_clear()
    yield tmp_path
    commit.cache_clear()


def git(folder: Path, *args: str) -> str:
    who = ["-c", "user.name=a", "-c", "user.email=a@b.c", "-c", "commit.gpgsign=false"]
    done = subprocess.run(["git", "-C", str(folder), *who, *args], capture_output=True, text=True, check=True)
    return done.stdout.strip()


def test_outside_a_clone_there_is_only_a_version(root: Path) -> None:
    assert commit() == ""
    assert version_line() == f"tossid {version()}"


def test_a_commit_and_whether_files_have_changed(root: Path) -> None:
    git(root, "init", "-q")
    (root / "a.txt").write_text("1")
    git(root, "add", "a.txt")
    git(root, "commit", "-qm", "first")
    head = git(root, "rev-parse", "HEAD")
    (root / "untracked.txt").write_text("")
    assert commit() == head
    assert version_line().endswith(f"({head[:12]})")
    (root / "a.txt").write_text("2")
    commit.cache_clear()
    assert commit() == f"{head}+changes"
    assert version_line().endswith(f"({head[:12]}+changes)")


def test_a_damaged_repository_is_no_error(root: Path) -> None:
    (root / ".git").mkdir()
    assert commit() == ""
