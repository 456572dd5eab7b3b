"""Mutants change what is computed, one thing each, and are tried against the tests that import their module."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

from benchmarks import mutants
from benchmarks.mutants import ROOMS, ROOT, drawn, files_that_test, killer, mutants_of

SOURCE = '''"""A - text."""
def f(x: list[0], name: str = "a" + "b") -> list[0]:
    if x[0] < -x[1] and len(x) >= 2:
        return f"{x[0] - 1}" + name
    return (x[0] +
            x[1]) - 3.0
'''


def test_signs_bounds_and_indices_are_changed_one_at_a_time(tmp_path: Path) -> None:
    path = tmp_path / "a.py"
    path.write_text(SOURCE)
    found = sorted(mutants_of(path), key=lambda each: (each.line, each.column))
    assert [(each.line + 1, each.old, each.new) for each in found] == [
        (3, "0", "1"), (3, "<", "<="), (3, "-", "+"), (3, "1", "2"), (3, ">=", ">"),
        (5, "0", "1"), (5, "+", "-"), (6, "1", "2"), (6, "-", "+"),
    ]  # fmt: skip
    for each in found:
        ast.parse(each.changed(SOURCE.encode()))


def test_the_same_seed_draws_the_same_and_tests_are_found() -> None:
    assert drawn(ROOMS, 8, 1) == drawn(ROOMS, 8, 1) != drawn(ROOMS, 8, 2)
    assert files_that_test(ROOT / "tossid/models/inertia.py")[0] == "tests/models/test_inertia.py"


def test_a_mutant_is_killed_by_a_test_that_passes_without_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(mutants, "ROOT", tmp_path)
    source = tmp_path / "a.py"
    source.write_text("def f(x):\n    return (x + 1) * (2 - 2)\n")
    tests = ["def test_broken():\n    assert f(1) == 5\n", "def test_f():\n    assert f(1) == 0\n"]
    (tmp_path / "test_a.py").write_text("from a import f\n\n" + "\n".join(tests))
    noticed = {mutant.old: killer(tmp_path, mutant, ["test_a.py"]) for mutant in mutants_of(source)}
    assert noticed == {"+": "", "-": "test_a.py::test_f"}
    assert "(x + 1) * (2 - 2)" in source.read_text()
