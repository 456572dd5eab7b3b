"""What refusing each hostile file of `claims.py` takes: `python -m tests.fuzz.measure_claims` prints a table.

All modules are imported first. Then each command runs in a fork of this process, so that its time and memory are
those of reading alone.
"""

from __future__ import annotations

import json
import os
import pkgutil
import resource
import signal
import sys
import tempfile
from collections.abc import Callable
from contextlib import suppress
from importlib import import_module
from pathlib import Path
from typing import Any

import pipelines
import tossid
from pipelines.cli import app
from tests.fuzz.claims import CLAIMS, described

LONGEST_S = 60
MOST = 4 << 30
"""Bytes of address space beyond this process's."""


def _forked(work: Callable[[], int]) -> tuple[int, float, int]:
    """Status, CPU time [s] and largest memory [bytes] of a call in a fork."""
    child = os.fork()
    if not child:
        signal.alarm(LONGEST_S)
        taken = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
        resource.setrlimit(resource.RLIMIT_AS, (taken + MOST, taken + MOST))
        status = 99
        try:
            status = work()
        finally:
            os._exit(status)
    _, status, used = os.wait4(child, 0)
    return os.waitstatus_to_exitcode(status), used.ru_utime + used.ru_stime, used.ru_maxrss * 1024


def measure(folder: Path, names: list[str]) -> dict[str, dict[str, Any]]:
    """Exit code, CPU seconds, megabytes, size of the file and words of each refusal."""
    for package in (tossid, pipelines):
        for module in pkgutil.walk_packages(package.__path__, f"{package.__name__}."):
            if not module.name.endswith("__main__"):
                with suppress(ModuleNotFoundError):  # of the viewer, an extra
                    import_module(module.name)
    found = {}
    for name in names:
        here = folder / name.replace(" ", "_")
        here.mkdir()
        os.chdir(here)
        words = CLAIMS[name].make(here)
        hostile = next(path for path in here.rglob("*") if path.name == CLAIMS[name].names)
        error = here / "stderr"

        def run(words: list[str] = words, error: Path = error) -> int:
            os.dup2(os.open(error, os.O_WRONLY | os.O_CREAT), 2)
            return app.run([*words, "--quiet"])

        _, _, baseline = _forked(lambda: 0)
        code, seconds, peak = _forked(run)
        found[name] = {
            "code": code,
            "seconds": seconds,
            "megabytes": (peak - baseline) / 2**20,
            "bytes": hostile.stat().st_size,
            "said": error.read_text() if error.exists() else "",
        }
    return found


if __name__ == "__main__":
    os.environ.pop("MLFLOW_TRACKING_URI", None)
    with tempfile.TemporaryDirectory() as temporary:
        measured = measure(Path(temporary), list(CLAIMS))
        os.chdir("/")
    print(json.dumps(measured) if "--json" in sys.argv else described(measured))
