"""With the command line and conf/ gone, the whole job can still be done."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]

JOB = """
import sys
sys.modules["pipelines"] = None  # an editable install would find it
import tossid

assert tossid.__file__.startswith(sys.argv[1]), tossid.__file__
noise = {"noise__position": 5e-4, "noise__rotation": 5e-3}
dataset = tossid.synthesize("cube", engine="lcp", tosses=12, seconds=0.8, effects={"gravity": {"g_ms2": 7.0}}, **noise)
model = tossid.train(dataset, model="cn", epochs=2, horizons=())
scores = tossid.evaluate(model, dataset.split("test"))
print(scores)
tossid.export(model, "model.xml")
model.save("model.pt")
dataset.save("tosses.h5")
"""
DIAGNOSIS = """
from tossid.physics.effects import LIBRARY

without = tuple(effect.name for effect in LIBRARY if effect.name not in ("gravity", "friction"))
gap = tossid.diagnose(dataset, without=without, repeats=0)
assert gap.named == ("gravity",), gap
gap.save("gap")
"""


@pytest.mark.parametrize(
    ("job", "files"),
    [
        (JOB, ["model.pt", "model.xml", "tosses.h5"]),
        pytest.param(JOB + DIAGNOSIS, ["gap", "model.pt", "model.xml", "tosses.h5"], marks=pytest.mark.slow),
    ],
)
def test_the_library_alone_does_the_job(tmp_path: Path, job: str, files: list[str]) -> None:
    alone, empty = tmp_path / "alone", tmp_path / "empty"
    half_written = shutil.ignore_patterns("*.tmp.*")  # by another process that compiles
    shutil.copytree(ROOT / "tossid", alone / "tossid", ignore=half_written)  # with the compiled kernels
    empty.mkdir()
    env = os.environ | {"PYTHONPATH": str(alone)}
    command = [sys.executable, "-c", job, str(alone)]
    done = subprocess.run(command, cwd=empty, env=env, capture_output=True, text=True, timeout=600)
    assert done.returncode == 0, done.stderr
    assert "rotation_error_deg" in done.stdout
    assert sorted(path.name for path in empty.iterdir()) == files
