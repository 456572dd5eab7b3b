"""Which tossid this is: its version and, in a clone, its commit."""

from __future__ import annotations

import subprocess
from functools import cache
from pathlib import Path

from tossid.versions import package_version

ROOT = Path(__file__).resolve().parents[2]


def version() -> str:
    """The installed version."""
    return package_version("tossid")


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


def version_line() -> str:
    """Version and commit, for people and logs."""
    where = commit()
    return f"tossid {version()}" + (
        f" ({where[:12]}{'+changes' if where.endswith('+changes') else ''})" if where else ""
    )


def _git(*args: str) -> str:
    done = subprocess.run(["git", "-C", str(ROOT), *args], capture_output=True, text=True, timeout=10, check=True)
    return done.stdout.strip()
