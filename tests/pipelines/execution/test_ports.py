"""Which ports commands open: none, or on loopback, or on the interface that was named."""

from __future__ import annotations

import ipaddress
import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.pipelines.commands.test_diagnose import FEW
from tests.pipelines.commands.test_kills import FILM
from tests.pipelines.execution.test_workers import slurm  # noqa: F401

HOOK = """
import os, sys
def note(event, args):
    if event == "socket.bind" and isinstance(args[1], tuple):
        with open(os.environ["BOUND"], "a") as log:
            log.write(f"{args[1][0]}\\n")
sys.addaudithook(note)
"""
"""Notes every address that a Python process, or a child of it, binds."""

STUDY = ["evaluate", "--sweep", "gravity", "sweep.models=[cn]", "sweep.train=['epochs=1']", "data=tosses"]
COMMANDS = [
    ["train", "model=cn", "epochs=2", "data=tosses"],
    ["evaluate"],
    [*STUDY, "sweep.values=[0,9.81]", "sweep.workers=2"],
    ["register", "name=cube"],
    ["export", "format=mjcf"],
    ["info", "tosses/tosses.h5"],
    ["doctor"],
    ["new-object", "name=brick", "box=[0.2,0.1,0.06]", "mass=0.8"],
    ["synthesize", *FILM, "out=data/raw/film"],
    ["detect"],
    ["track"],
    ["ingest", "out=ingested.h5"],
    ["view", "sheet=sheet.png"],
]
SLOW = [
    ["diagnose", "data=tosses", "tosses=6", FEW],
    ["audit", "cases=1", "tosses=6"],
]


def bound_by(folder: Path, *args: str) -> list[str]:
    """Addresses that a command binds."""
    (folder / "hook").mkdir(exist_ok=True)
    (folder / "hook/sitecustomize.py").write_text(HOOK)
    log = folder / "bound.txt"
    log.unlink(missing_ok=True)
    path = os.pathsep.join([str(folder / "hook"), str(Path(__file__).parents[3])])
    command, env = (
        [sys.executable, "-m", "pipelines.cli.app", *args],
        os.environ | {"PYTHONPATH": path, "BOUND": str(log)},
    )
    done = subprocess.run([*command, "--quiet"], cwd=folder, env=env, capture_output=True, text=True, timeout=3600)
    assert done.returncode == 0, done.stderr
    return log.read_text().split() if log.exists() else []


def outside(addresses: list[str]) -> list[str]:
    """Those that another machine can reach."""
    return [address for address in addresses if not address or not ipaddress.ip_address(address).is_loopback]


def test_an_open_port_is_noticed(tmp_path: Path) -> None:
    (tmp_path / "hook").mkdir()
    (tmp_path / "hook/sitecustomize.py").write_text(HOOK)
    script = "import socket; s = socket.socket(); s.bind(('0.0.0.0', 0)); t = socket.socket(); t.bind(('127.0.0.1', 0))"
    env = os.environ | {"PYTHONPATH": str(tmp_path / "hook"), "BOUND": str(tmp_path / "bound.txt")}
    subprocess.run([sys.executable, "-c", script], env=env, check=True, timeout=60)
    assert outside((tmp_path / "bound.txt").read_text().split()) == ["0.0.0.0"]


@pytest.mark.slow
def test_no_command_listens_to_other_machines(beside: Path) -> None:
    found = {" ".join(command): outside(bound_by(beside, *command)) for command in COMMANDS + SLOW}
    assert not any(found.values()), found


@pytest.mark.slow
def test_slurms_scheduler_and_workers_listen_on_the_named_interface_alone(
    slurm: Path,  # noqa: F811
    beside: Path,
) -> None:
    keys = ["launcher=slurm", "launcher.jobs=1", "launcher.interface=lo", "launcher.memory=2GiB"]
    addresses = bound_by(beside, *STUDY, "sweep.values=[9.81]", *keys)
    assert addresses, "a scheduler has to listen somewhere"
    assert outside(addresses) == []
