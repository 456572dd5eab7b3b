"""No module and no folder is too large to read."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

from tests.conftest import ROOT

MOST_LINES, MOST_FILES = 400, 20
"""Of a module, and in a folder (CONTRIBUTING.md, rule 12)."""


def test_no_module_and_no_folder_is_too_large_to_read() -> None:
    every = [*modules("tossid"), *modules("pipelines")]
    lines = {module: len((ROOT / module).read_text(encoding="utf-8").splitlines()) for module in every}
    assert {module: count for module, count in lines.items() if count > MOST_LINES} == {}
    files = Counter(str(Path(module).parent) for module in every)
    assert {folder: count for folder, count in files.items() if count > MOST_FILES} == {}


def modules(package: str) -> list[str]:
    """The modules of a package as paths from the root."""
    return sorted(path.relative_to(ROOT).as_posix() for path in (ROOT / package).rglob("*.py"))
