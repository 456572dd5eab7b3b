"""`python -m benchmarks.mutants --count 40`: small faults in the sources, and the tests that notice them.

A mutant is one change of one expression: a sign (+ to -), a bound (< to <=), an index (0 to 1).
Mutants are drawn with a seed, so that the same call tries the same ones. Each is tried in a copy of the source tree,
against the tests that import its module, the nearest first. A test that also fails without the change does not count.
"""

from __future__ import annotations

import argparse
import ast
import os
import random
import re
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parents[1]
ROOMS = ("physics", "motion", "models", "diagnosis")
SIGNS = {ast.Add: ("+", "-"), ast.Sub: ("-", "+"), ast.USub: ("-", "+")}
BOUNDS = {ast.Lt: ("<", "<="), ast.LtE: ("<=", "<"), ast.Gt: (">", ">="), ast.GtE: (">=", ">")}
MOST_FILES = 6
"""Test files that a mutant is tried against."""
LONGEST_S = 900
"""After which a mutant's tests are taken not to end."""


@dataclass(frozen=True)
class Mutant:
    """A change of a source file: `old` at a place becomes `new`. Lines and columns (in bytes) are counted from 0."""

    path: Path
    line: int
    column: int
    old: str
    new: str

    def __str__(self) -> str:
        text = self.path.read_text().splitlines()[self.line].strip()
        return f"{self.path.relative_to(ROOT)}:{self.line + 1}: {self.old} to {self.new} in `{text}`"

    def changed(self, source: bytes) -> bytes:
        """The source with the change."""
        at = sum(map(len, source.splitlines(keepends=True)[: self.line])) + self.column
        return source[:at] + self.new.encode() + source[at + len(self.old) :]


def mutants_of(path: Path) -> Iterator[Mutant]:
    """All mutants of a file, but for those of its annotations and of text."""
    source = path.read_bytes()
    lines = source.splitlines()

    def operator(op: ast.AST, row: int, column: int) -> Iterator[Mutant]:
        """Of what stands at a place, but for blanks and brackets."""
        old, new = (SIGNS | BOUNDS).get(type(op), ("", ""))
        found = re.match(rb"[\s)]*(" + re.escape(old.encode()) + rb")(?!=)", lines[row][column:])
        if old and found:
            yield Mutant(path, row, column + found.start(1), old, new)

    def visit(node: ast.AST) -> Iterator[Mutant]:
        if isinstance(node, ast.UnaryOp) and not isinstance(node.operand, ast.Constant):
            yield from operator(node.op, node.lineno - 1, node.col_offset)
        elif isinstance(node, ast.BinOp | ast.Compare) and not any(map(_is_text, ast.walk(node))):
            op = node.op if isinstance(node, ast.BinOp) else node.ops[0]
            yield from operator(op, (node.left.end_lineno or 1) - 1, node.left.end_col_offset or 0)
        elif isinstance(node, ast.Subscript) and isinstance(node.slice, ast.Constant):
            index, value = node.slice, node.slice.value
            if isinstance(value, int):
                yield Mutant(path, index.lineno - 1, index.col_offset, str(value), str(value + 1))
        for name, value in ast.iter_fields(node):
            if name not in ("annotation", "returns", "decorator_list"):
                for child in value if isinstance(value, list) else [value]:
                    if isinstance(child, ast.AST) and not isinstance(child, ast.JoinedStr):
                        yield from visit(child)

    yield from visit(ast.parse(source))


def _is_text(node: ast.AST) -> bool:
    is_string = isinstance(node, ast.Constant) and not isinstance(node.value, int | float)
    return is_string or isinstance(node, ast.JoinedStr)


def drawn(rooms: tuple[str, ...], count: int, seed: int) -> list[Mutant]:
    """So many mutants of the rooms' modules; each of all mutants is as likely."""
    paths = [path for room in rooms for path in sorted((ROOT / "tossid" / room).rglob("*.py"))]
    return random.Random(seed).sample([mutant for path in paths for mutant in mutants_of(path)], count)


def files_that_test(path: Path) -> list[str]:
    """Test files that are named as a module, import it or its package, or lie beside such; the nearest first."""
    parts = path.relative_to(ROOT).with_suffix("").parts
    module, package = (re.compile(rf"^\s*(?:from|import) {'[.]'.join(each)} ", re.M) for each in (parts, parts[:-1]))
    found = []
    for test in sorted((ROOT / "tests").rglob("test_*.py")):
        text, beside = test.read_text(), test.parent.relative_to(ROOT / "tests").parts == parts[1:-1]
        near = 4 * (test.stem == f"test_{parts[-1]}") + 3 * bool(module.search(text)) + bool(package.search(text))
        near += 2 * beside
        if near:
            found.append((-near, str(test.relative_to(ROOT))))
    return [name for _, name in sorted(found)[:MOST_FILES]]


def killer(folder: Path, mutant: Mutant, tests: list[str]) -> str:
    """The test that notices a mutant, "timeout" where the tests do not end, "" where none does."""
    target, spared = folder / mutant.path.relative_to(ROOT), list[str]()
    whole = target.read_bytes()
    while True:
        target.write_bytes(mutant.changed(whole))
        try:
            failed = _first_failure(folder, [*tests, *(f"--deselect={name}" for name in spared)])
        except subprocess.TimeoutExpired:
            return "timeout"
        finally:
            target.write_bytes(whole)
        if not failed or failed in spared or not _first_failure(folder, [failed]):
            return failed
        spared.append(failed)


def _first_failure(folder: Path, args: list[str]) -> str:
    """The first test that fails or cannot be collected, "" where all pass."""
    words = [sys.executable, "-m", "pytest", "-q", "-x", "-p", "no:cacheprovider", "--tb=no", *args]
    environment = os.environ | {"PYTHONPATH": str(folder)}
    done = subprocess.run(words, cwd=folder, env=environment, stdout=subprocess.PIPE, text=True, timeout=LONGEST_S)
    found = re.search(r"^(?:FAILED|ERROR) (.+?)(?: - .*)?$", done.stdout, re.MULTILINE)
    return found.group(1) if found else ("" if done.returncode in (0, 5) else f"exit code {done.returncode}")


def main() -> None:
    """Print a line for each mutant, then those that no test noticed."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("rooms", nargs="*", default=ROOMS)
    parser.add_argument("--count", type=int, default=40, help="how many are drawn")
    parser.add_argument("--seed", type=int, default=1, help="of the drawing")
    parser.add_argument("--first", type=int, default=0, help="the mutant to begin with, of those that are drawn")
    asked = parser.parse_args()
    survivors, mutants = [], drawn(tuple(asked.rooms), asked.count, asked.seed)[asked.first :]
    with tempfile.TemporaryDirectory() as temporary:
        left_out = shutil.ignore_patterns(".*", "outputs", "mlruns", "build")
        folder = shutil.copytree(ROOT, Path(temporary) / "copy", ignore=left_out)
        for number, mutant in enumerate(mutants, start=asked.first):
            started, files = time.monotonic(), files_that_test(mutant.path)
            by = killer(folder, mutant, files)
            survivors += [] if by else [mutant]
            result = f"killed by {by}" if by else f"SURVIVED {len(files)} test files"
            print(f"{number} {mutant}: {result} ({time.monotonic() - started:.0f} s)", flush=True)
    print(f"{len(mutants) - len(survivors)} of {len(mutants)} killed; not noticed:", *survivors, sep="\n  ")


if __name__ == "__main__":
    main()
