"""Help pages and what Tab offers: every command and key, without heavy imports."""

from __future__ import annotations

import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from pipelines.cli import app
from pipelines.cli.help import command_names

LIGHT = """
import sys
from pipelines.cli import app
codes = [app.run(args) for args in (["--help"], ["--version"], ["train", "--help"], ["diagnose", "--help"])]
heavy = {"hydra", "omegaconf", "mlflow", "torch", "numpy", "numba", "cv2", "h5py", "mujoco"} & set(sys.modules)
sys.exit(f"imported {heavy}" if heavy or any(codes) else 0)
"""


def test_help_names_every_command_and_imports_nothing_heavy(project: Path) -> None:
    done = subprocess.run([sys.executable, "-c", LIGHT], capture_output=True, text=True, timeout=60)
    assert done.returncode == 0, done.stderr
    assert "\ntossid 0." in done.stdout
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


# ---------------------------------------------------------------- completion


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (["tra"], ["track", "train"]),
        (["train", "optim"], ["optimizer=lbfgs", "optimizer=adam"]),
        (["train", "pat"], ["patience=", "patience=<a whole number of at least 1>"]),
        (["train", "model", "=", "cnrp"], ["cnrp", "cnrp_world", "cnrpi"]),
        (["train", "restart", "="], ["true", "false"]),
        (["train", "--q"], ["--quiet"]),
        (
            ["evaluate", "launcher=dask", "launcher."],
            ["launcher.address=", "launcher.tls=", "launcher.insecure=", "launcher.wait_s="],
        ),
        (["train", "nothing"], [""]),
    ],
)
def test_what_tab_offers(
    monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str], words: list[str], expected: list[str]
) -> None:
    monkeypatch.setenv("_TOSSID_COMPLETE", "complete_bash")
    monkeypatch.setenv("COMP_WORDS", "\n".join(["tossid", *words]))
    monkeypatch.setenv("COMP_CWORD", str(len(words)))
    with pytest.raises(SystemExit):
        app.run([])
    assert capfd.readouterr().out.split("\n")[:-1] == expected


@pytest.mark.skipif(shutil.which("bash") is None, reason="no bash here")
def test_the_script_works_in_bash(tmp_path: Path) -> None:
    script = f"""
    eval "$({sys.executable} -c 'from pipelines.cli import app; app.main(["--show-completion", "bash"])')"
    printf '#!/bin/sh\\nexec {sys.executable} -m pipelines.cli.app "$@"\\n' > tossid; chmod +x tossid
    COMP_WORDS=(tossid synth); COMP_CWORD=1
    _tossid_completion "{tmp_path}/tossid"
    echo "${{COMPREPLY[@]}}"
    """
    done = subprocess.run(["bash", "-c", script], capture_output=True, text=True, timeout=60, cwd=tmp_path)
    assert done.stdout.split() == ["synthesize"], done.stderr
