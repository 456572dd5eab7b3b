"""Which tossid this is: its version and, in a clone, its commit."""

from __future__ import annotations

import ast
import hashlib
import subprocess
from functools import cache
from importlib import metadata
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent

_LEARNING = ("learning", "checkpoints")
_NO_NUMBERS = ("vision", "store", "figures", "diagnosis")
"""Rooms of tossid that a training and its evaluation do without."""


def version() -> str:
    """The installed version."""
    try:
        return metadata.version("tossid")
    except metadata.PackageNotFoundError:
        return "unknown"


@cache
def commit() -> str:
    """The clone's commit, with "+changes" where tracked files differ from it; "" outside a clone."""
    if not (ROOT / ".git").exists():
        return ""
    try:
        head = _git("rev-parse", "HEAD")
        changed = _git("status", "--porcelain", "--untracked-files=no")
    except (OSError, subprocess.SubprocessError):
        return ""
    return f"{head}+changes" if changed else head


@cache
def code_digest() -> str:
    """A hash of the code that numbers depend on, as it is parsed: comments, docstrings and layout do not count."""
    found = hashlib.sha256()
    for path in sorted((ROOT / "tossid").rglob("*.py")) + [ROOT / "pipelines" / f"{name}.py" for name in _LEARNING]:
        if not any(part in _NO_NUMBERS for part in path.relative_to(ROOT).parts):
            found.update(f"{path.relative_to(ROOT).as_posix()}\n{_parsed(path)}\n".encode())
    return found.hexdigest()


@cache
def code_digest_with(room: str, without: tuple[str, ...] = ()) -> str:
    """The same with a room of tossid that trainings do without, but for the modules that are named."""
    found = hashlib.sha256(code_digest().encode())
    for path in sorted((ROOT / "tossid" / room).rglob("*.py")):
        if path.stem not in without:
            found.update(f"{path.relative_to(ROOT).as_posix()}\n{_parsed(path)}\n".encode())
    return found.hexdigest()


def _parsed(path: Path) -> str:
    tree = ast.parse(path.read_bytes())
    for node in ast.walk(tree):
        if isinstance(node, (ast.Module, ast.ClassDef, ast.FunctionDef)):
            texts = [part for part in node.body if isinstance(part, ast.Expr) and isinstance(part.value, ast.Constant)]
            node.body = [part for part in node.body if part not in texts]
    return ast.dump(tree)


def version_line() -> str:
    """Version and commit, for people and logs."""
    where = commit()
    return f"tossid {version()}" + (
        f" ({where[:12]}{'+changes' if where.endswith('+changes') else ''})" if where else ""
    )


def _git(*args: str) -> str:
    done = subprocess.run(["git", "-C", str(ROOT), *args], capture_output=True, text=True, timeout=10, check=True)
    return done.stdout.strip()
