"""tossid as `pip install .` leaves it, used from an empty folder: nothing of the clone is within reach."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

CLONE = Path(__file__).parents[2]

Tossid = Callable[..., Any]


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The wheel that pip builds of this clone."""
    folder = tmp_path_factory.mktemp("wheel")
    command = [sys.executable, "-m", "pip", "wheel", "--quiet", "--no-deps", "--no-build-isolation", "-w", str(folder)]
    subprocess.run([*command, str(CLONE)], check=True, capture_output=True, text=True, timeout=300)
    return next(folder.glob("tossid-*.whl"))


@pytest.fixture(scope="module")
def installed(wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder that the wheel is unpacked in, as pip unpacks it in site-packages."""
    folder = tmp_path_factory.mktemp("site-packages")
    with zipfile.ZipFile(wheel) as archive:
        archive.extractall(folder)
    for path in (CLONE / "tossid").rglob("*.nb[ic]"):  # compiled kernels, which are valid for a digest of their sources
        there = folder / path.relative_to(CLONE)
        there.parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(path, there)
    return folder


@pytest.fixture
def tossid(installed: Path, tmp_path: Path) -> Tossid:
    """Run an installed command in an empty folder; returns what it prints as JSON."""

    def run(*args: str) -> Any:
        env = {name: value for name, value in os.environ.items() if name != "MLFLOW_TRACKING_URI"}
        command = [sys.executable, "-m", "pipelines.cli.app", *args, "--json", "--quiet"]
        done = subprocess.run(
            command, cwd=tmp_path, env=env | {"PYTHONPATH": str(installed)}, capture_output=True, text=True, timeout=600
        )
        assert done.returncode == 0, done.stderr
        return json.loads(done.stdout)

    return run


def test_the_wheel_holds_what_a_user_needs_and_claims_no_other_name(wheel: Path) -> None:
    with zipfile.ZipFile(wheel) as archive:
        names = archive.namelist()
    tops = {name.split("/")[0] for name in names}
    assert {top for top in tops if not top.endswith(".dist-info")} == {"tossid", "pipelines"}
    in_clone = {path.relative_to(CLONE / "conf").as_posix() for path in (CLONE / "conf").rglob("*.yaml")}
    assert in_clone <= {name.removeprefix("pipelines/conf/") for name in names if name.startswith("pipelines/conf/")}
    assert any(name.startswith("pipelines/sample/frames/") for name in names)


def test_a_command_of_the_installed_package_writes_where_the_user_stands(tossid: Tossid, tmp_path: Path) -> None:
    made = tossid("synthesize", "tosses=3", "frames=false", "engine=lcp", "seconds=0.5")
    assert made["n_tosses"] == 3
    assert [path.name for path in tmp_path.iterdir()] == ["data"]


@pytest.mark.slow
def test_the_whole_job_from_an_empty_folder(tossid: Tossid, tmp_path: Path) -> None:
    tossid("synthesize", "tosses=12", "seed=1")
    assert tossid("ingest")["n_tosses"] == 12
    assert tossid("train", "model=cnrpi")["model"] == "cnrpi"
    assert len(tossid("evaluate", "--sweep", "gravity")["cells"]) > 0
    assert tossid("diagnose")["schema"] == "tossid.gap/1"
    for name in ("data/datasets", "outputs/train", "outputs/sweeps", "outputs/diagnose", "mlflow.db"):
        assert (tmp_path / name).exists(), name
