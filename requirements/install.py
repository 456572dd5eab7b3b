"""Run pip, and print a line every few seconds; at the end, how much it installed and how long that took.

Usage: python install.py ARGUMENTS OF PIP INSTALL
"""

from __future__ import annotations

import subprocess
import sys
import time
from pathlib import Path

EVERY_S = 5.0
"""Seconds between two lines."""


def main(arguments: list[str]) -> int:
    """Install; returns pip's exit status.

    Args:
        arguments: Of `pip install`.
    """
    begun, before = time.monotonic(), megabytes()
    with subprocess.Popen([sys.executable, "-m", "pip", "install", "--quiet", *arguments]) as pip:
        while True:
            try:
                status = pip.wait(EVERY_S)
                break
            except subprocess.TimeoutExpired:
                say(f"installing packages: {megabytes() - before:.0f} MB in {time.monotonic() - begun:.0f} s")
    if status == 0:
        say(f"installed {megabytes() - before:.0f} MB in {time.monotonic() - begun:.0f} s")
    return status


def megabytes() -> float:
    """Size of the environment [MB]."""
    found = (path.lstat().st_size for path in Path(sys.prefix).rglob("*") if not path.is_symlink() and path.is_file())
    return 1e-6 * sum(found)


def say(line: str) -> None:
    """A line on standard error."""
    print(line, file=sys.stderr, flush=True)  # noqa: T201


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
