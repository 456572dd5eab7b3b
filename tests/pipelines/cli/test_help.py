"""Help pages list every command and key, and import nothing heavy."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from pipelines.cli import app
from pipelines.cli.help import command_names
from tests.pipelines.conftest import Run


def test_help_names_every_command(tossid: Run) -> None:
    done = tossid("--help")  # in a process of its own, as a user calls it
    assert done.returncode == 0
    for name in command_names():
        assert name in done.stdout


@pytest.mark.parametrize("name", command_names())
def test_help_lists_keys_with_units(project: Path, capfd: pytest.CaptureFixture[str], name: str) -> None:
    assert app.run([name, "--help"]) == 0
    out, err = capfd.readouterr()
    assert err == ""
    assert f"tossid {name}" in out
    if name == "ingest":
        for words in ("source=", "contactnets", "source.half_width", "0.0524", "[m]", "[m/s²]"):
            assert words in out


def test_help_imports_nothing_heavy(project: Path) -> None:
    script = (
        "import sys\nfrom pipelines.cli import app\n"
        "code = app.run(sys.argv[1:])\n"
        "heavy = {'hydra', 'omegaconf', 'mlflow', 'torch', 'numpy', 'numba', 'cv2', 'h5py', 'mujoco'}\n"
        "heavy &= set(sys.modules)\n"
        "sys.exit(f'imported {heavy}' if heavy or code else 0)"
    )
    for args in (["--help"], ["train", "--help"], ["diagnose", "--help"], ["ingest", "--help"]):
        done = subprocess.run([sys.executable, "-c", script, *args], capture_output=True, text=True, timeout=60)
        assert done.returncode == 0, done.stderr
