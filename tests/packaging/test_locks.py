"""The lock files hold what `pyproject.toml` asks for, each package with its hashes."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name
from packaging.version import Version

CLONE = Path(__file__).parents[2]
LOCKS = sorted((CLONE / "requirements").glob("*.txt"))
_HASHES = r"((?:    --hash=sha256:[0-9a-f]{64}(?: \\)?\n)+)"
_PACKAGE = re.compile(r"^([\w.-]+)==(\S+)(?: ;[^\\]*)? \\\n" + _HASHES, re.MULTILINE)


def locked(path: Path) -> dict[str, list[Version]]:
    """Versions by package; a package may have several, for several Pythons."""
    found: dict[str, list[Version]] = {}
    text = path.read_text()
    for name, version, _ in _PACKAGE.findall(text):
        found.setdefault(canonicalize_name(name), []).append(Version(version))
    assert sum(map(len, found.values())) == sum(not line.startswith(" ") for line in text.splitlines())
    return found


def wanted() -> list[Requirement]:
    """What tossid and its extra `dev` need."""
    project = tomllib.loads((CLONE / "pyproject.toml").read_text())["project"]
    extras = project["optional-dependencies"]
    texts = [*project["dependencies"], *extras["dev"]]
    nested = [Requirement(text) for text in texts if text.startswith("tossid[")]
    texts += [text for one in nested for extra in one.extras for text in extras[extra]]
    return [Requirement(text) for text in texts if not text.startswith("tossid[")]


@pytest.mark.parametrize("path", LOCKS, ids=lambda path: path.stem)
def test_a_lock_holds_what_is_asked_for(path: Path) -> None:
    there = locked(path)
    versions = [(one, there.get(canonicalize_name(one.name), [])) for one in wanted()]
    wrong = [str(one) for one, found in versions if not any(one.specifier.contains(version) for version in found)]
    assert not wrong


def test_the_locks_differ_in_torch_and_what_it_brings_alone() -> None:
    cpu, cuda = (locked(CLONE / "requirements" / f"{name}.txt") for name in ("cpu", "cuda"))
    assert cpu["torch"] != cuda["torch"]
    assert {name for name in cpu if name != "torch" and cpu[name] != cuda.get(name)} == set()
    further = {name for name in cuda if name not in cpu}
    assert all(name.startswith(("nvidia-", "cuda-")) or name == "triton" for name in further), further


def test_what_runs_tossid_is_a_part_of_each_lock_and_has_all_that_it_needs() -> None:
    names = {canonicalize_name(name) for name in (CLONE / "requirements" / "run.names").read_text().split()}
    project = tomllib.loads((CLONE / "pyproject.toml").read_text())["project"]
    needed = [Requirement(text) for text in (*project["dependencies"], "hatchling", "editables")]
    assert {canonicalize_name(one.name) for one in needed} <= names
    assert not names & {"mypy", "mkdocs", "distributed", "psycopg2-binary"}
    assert names <= set(locked(CLONE / "requirements" / "cuda.txt"))
