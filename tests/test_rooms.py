"""Every module with logic has a test file of its own, in a folder of the same name, and none is too large."""

from __future__ import annotations

import ast
from collections import Counter
from pathlib import Path

from tests.conftest import ROOT

FEWEST_STATEMENTS = 5
"""A module whose functions have so many statements together has logic to test."""

MOST_LINES, MOST_FILES = 400, 20
"""Of a module, and in a folder (CONTRIBUTING.md, rule 12)."""

WITHOUT = {
    "pipelines/config/schemas/launching.py": "fields only",
    "pipelines/tools/benchmarks/bench_against.py": "times two trees; its parts are those of tossid/physics",
    "pipelines/tools/benchmarks/bench_vision.py": "measures speed; its parts are those of tossid/vision",
    "pipelines/tools/experiments/unknown.py": "trains on the published cube; its parts are those of tossid/training",
    "pipelines/tools/experiments/sessions.py": "measures published recordings; its parts are those of tossid/motion",
    "pipelines/tools/experiments/scores_by_group.py": "prints scores; its parts are those of tossid/evaluation",
    "tossid/motion/sessions/witnesses.py": "held to known recordings by tests/motion/sessions/test_search.py",
    "tossid/vision/recordings/image_header.py": "held to hostile files by tests/fuzz/test_claims.py",
    "tossid/vision/recordings/rosbag_budget.py": "held to hostile files by tests/fuzz/test_claims.py",
    "tossid/models/__init__.py": "imports its names when they are first used, as every test of the room does",
    "tossid/store/__init__.py": "imports its names when they are first used, as every test of the room does",
}
"""Modules that have no test file of their own, and why."""


def test_every_module_with_logic_has_its_test_file() -> None:
    missing = [
        module
        for module in (*modules("tossid"), *modules("pipelines"))
        if statements(ROOT / module) >= FEWEST_STATEMENTS and not (ROOT / place_of_test(module)).is_file()
    ]
    assert [module for module in missing if module not in WITHOUT] == []


def test_the_exceptions_are_still_needed() -> None:
    for module in WITHOUT:
        assert (ROOT / module).is_file(), module
        assert not (ROOT / place_of_test(module)).is_file(), module


def test_no_module_and_no_folder_is_too_large_to_read() -> None:
    every = [*modules("tossid"), *modules("pipelines")]
    lines = {module: len((ROOT / module).read_text(encoding="utf-8").splitlines()) for module in every}
    assert {module: count for module, count in lines.items() if count > MOST_LINES} == {}
    files = Counter(str(Path(module).parent) for module in every)
    assert {folder: count for folder, count in files.items() if count > MOST_FILES} == {}


def modules(package: str) -> list[str]:
    """The modules of a package as paths from the root."""
    return sorted(path.relative_to(ROOT).as_posix() for path in (ROOT / package).rglob("*.py"))


def place_of_test(module: str) -> str:
    """Where a module's test file is: tossid/vision/cameras/rig.py has tests/vision/cameras/test_rig.py."""
    parts = Path(module.removeprefix("tossid/")).parts
    if parts[-1] == "__init__.py":
        parts = (*parts[:-2], f"{parts[-2]}.py") if len(parts) > 1 else ("face.py",)
    return str(Path("tests", *parts[:-1], f"test_{parts[-1].removeprefix('_')}"))


def statements(path: Path) -> int:
    """Statements inside a module's functions, docstrings apart."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    functions = [node for node in ast.walk(tree) if isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef))]
    inside = {id(node): node for function in functions for part in function.body for node in ast.walk(part)}
    return sum(isinstance(node, ast.stmt) and not is_text(node) for node in inside.values())


def is_text(node: ast.stmt) -> bool:
    return isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant)
