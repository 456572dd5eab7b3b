"""Run pip, and print a line every few seconds; at the end, how much it installed and how long that took.

Usage: python install.py [--only NAMES LOCK] ARGUMENTS OF PIP INSTALL

`--only` installs those packages of a lock file whose names a file has.
"""

from __future__ import annotations

import os
import re
import subprocess
import sys
import tempfile
import time
from contextlib import suppress
from pathlib import Path

EVERY_S = 5.0
"""Seconds between two lines."""


def main(arguments: list[str]) -> int:
    """Install; returns pip's exit status.

    Args:
        arguments: Of `pip install`.
    """
    if arguments[:1] == ["--only"]:
        with tempfile.TemporaryDirectory() as folder:
            part = Path(folder) / "lock.txt"
            part.write_text(packages_of(Path(arguments[2]), Path(arguments[1])))
            return main([*arguments[3:], "-r", str(part)])
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


def packages_of(lock: Path, names: Path) -> str:
    """The entries of a lock file, each with its hashes, whose names a file has.

    Args:
        lock: The lock file.
        names: A name a line.
    """
    wanted = set(names.read_text().split())
    entries = re.split(r"^(?=\S)", lock.read_text(), flags=re.MULTILINE)
    return "".join(entry for entry in entries if entry.partition("==")[0] in wanted)


def megabytes() -> float:
    """Size of the environment [MB]."""
    total = 0
    for folder, _, names in os.walk(sys.prefix):  # (it passes over folders that pip removes meanwhile)
        for name in names:
            with suppress(FileNotFoundError):
                total += os.lstat(os.path.join(folder, name)).st_size
    return 1e-6 * total


def say(line: str) -> None:
    """A line on standard error."""
    print(line, file=sys.stderr, flush=True)  # noqa: T201


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
