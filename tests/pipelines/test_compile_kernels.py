"""Once kernels are compiled, first commands compile nothing."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

FIRST = """
from numba.core import event
import tossid

with event.install_recorder("numba:compile") as compiled:
    for name in ("cube", "elbow"):
        tossid.synthesize(name, engine="lcp", tosses=1)
print(len(compiled.buffer))
"""


@pytest.mark.slow
def test_first_simulations_compile_nothing(tmp_path: Path) -> None:
    def run(folder: str, *arguments: str) -> str:
        kept = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path / folder)}
        done = subprocess.run(
            [sys.executable, *arguments], env=kept, capture_output=True, text=True, check=True, timeout=600
        )
        return done.stdout.strip()

    assert int(run("empty", "-c", FIRST)) > 0
    run("filled", "-m", "pipelines.compile_kernels")
    assert int(run("filled", "-c", FIRST)) == 0
