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
    words = ["describe", "--always", "--exclude=*", "--abbrev=40", "--dirty=+changes"]
    try:
        done = subprocess.run(["git", "-C", str(ROOT), *words], capture_output=True, text=True, timeout=10, check=True)
    except (OSError, subprocess.SubprocessError):
        return ""
    return done.stdout.strip()


def version_line() -> str:
    """Version and commit, for people and logs."""
    head, plus, changes = commit().partition("+")
    return f"tossid {version()}" + (f" ({head[:12]}{plus}{changes})" if head else "")
