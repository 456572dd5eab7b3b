"""A copy of the packages and of conf/, to be edited and run by other processes."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

from tests.conftest import ROOT


class Copy:
    """A copy of the source tree."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        for name in ("tossid", "pipelines", "conf"):
            shutil.copytree(ROOT / name, folder / name, ignore=shutil.ignore_patterns("__pycache__"))

    def edit(self, path: str, old: str, new: str) -> None:
        """Replace what a regular expression finds first in a file."""
        file = self.folder / path
        text, count = re.subn(old, new, file.read_text(), count=1, flags=re.MULTILINE)
        assert count == 1, f"{path} has no {old}"
        file.write_text(text)

    def python(self, code: str) -> str:
        """What a program prints that imports the copy."""
        env = dict(os.environ, PYTHONPATH=str(self.folder))
        done = subprocess.run([sys.executable, "-c", code], cwd=self.folder, env=env, capture_output=True, text=True)
        assert done.returncode == 0, done.stderr
        return done.stdout.strip()
