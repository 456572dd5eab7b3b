"""Small files that claim much are refused through the command line, in 2 s and 500 MB, with the file and the claim.

`python -m tests.fuzz.test_claims` prints what refusing each of them takes. All modules are imported first, and each
command runs in a fork of this process, so that its time and memory are those of reading alone.
"""

from __future__ import annotations

import json
import os
import pkgutil
import resource
import signal
import subprocess
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
from tests.conftest import ROOT
from tests.fuzz.claims import CLAIMS

LONGEST_S = 60
MOST = 4 << 30
"""Bytes of address space beyond this process's."""


def test_each_small_file_with_a_huge_claim_is_refused_fast_and_in_little_memory() -> None:
    command = [sys.executable, "-m", "tests.fuzz.test_claims"]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr
    measured = [json.loads(line) for line in done.stdout.splitlines()]
    assert [each["file"] for each in measured] == list(CLAIMS)
    for each in measured:
        (line,), claim = each["said"].strip().splitlines(), CLAIMS[each["file"]]
        assert each["code"] == 2, each
        assert claim.names in line, each
        assert claim.says in line, each
        assert each["seconds"] < 2, each
        assert each["megabytes"] < 500, each
        assert each["bytes"] < 5 << 20, each


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


def _measured(folder: Path, name: str) -> dict[str, Any]:
    """Exit code, CPU seconds, megabytes, size of the file and words of a refusal."""
    folder.mkdir()
    os.chdir(folder)
    words, error = CLAIMS[name].make(folder), folder / "stderr"
    size = next(path for path in folder.rglob("*") if path.name == CLAIMS[name].names).stat().st_size

    def run() -> int:
        os.dup2(os.open(error, os.O_WRONLY | os.O_CREAT), 2)
        return app.run([*words, "--quiet"])

    _, _, baseline = _forked(lambda: 0)
    code, seconds, peak = _forked(run)
    megabytes = round((peak - baseline) / 2**20)
    said = error.read_text() if error.exists() else ""
    return {
        "file": name,
        "bytes": size,
        "seconds": round(seconds, 2),
        "megabytes": megabytes,
        "code": code,
        "said": said,
    }


def main() -> None:
    """Print what each refusal takes, an object of JSON a line."""
    os.environ.pop("MLFLOW_TRACKING_URI", None)
    for package in (tossid, pipelines):
        for module in pkgutil.walk_packages(package.__path__, f"{package.__name__}."):
            if not module.name.endswith("__main__"):
                with suppress(ModuleNotFoundError):  # of the viewer, an extra
                    import_module(module.name)
    with tempfile.TemporaryDirectory() as temporary:
        for name in CLAIMS:
            print(json.dumps(_measured(Path(temporary) / name.replace(" ", "_"), name)), flush=True)
        os.chdir("/")


if __name__ == "__main__":
    main()
