"""Which code this is, and Ctrl-C that waits until what must not be left half done is done."""

from __future__ import annotations

import signal
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest

from pipelines.execution import code_version
from pipelines.execution.code_version import commit, version_line
from pipelines.execution.process import interrupted_later


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


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_waits_until_the_end_and_handlers_come_back(number: signal.Signals) -> None:
    before, done = signal.getsignal(number), []
    with pytest.raises(KeyboardInterrupt), interrupted_later():
        signal.raise_signal(number)
        done.append(1)
    assert done == [1]
    assert signal.getsignal(number) is before
