"""Every command as a process of its own, and what may disturb it: a full or read-only disk."""

from __future__ import annotations

import json
import os
import sqlite3
import subprocess
import sys
from contextlib import closing
from pathlib import Path

import cv2
import numpy as np

from tests.conftest import ROOT
from tests.pipelines.conftest import KEYS
from tossid.models import TrainedModel
from tossid.objects import load_object
from tossid.physics.effects import LIBRARY
from tossid.store import read_dataset

FEW = f"without=[{','.join(each.name for each in LIBRARY if each.name not in ('friction', 'gravity', 'inertia'))}]"
"""A small library is a short diagnosis."""

COMMANDS = {
    "synthesize": "synthesize frames=false engine=lcp tosses=10 seconds=0.8 noise.position=0.0005 out=tosses",
    "film": "synthesize tosses=1 camera.count=2 camera.samples=2 camera.pause_s=[0.1,0.1] camera.carry_s=[0.2,0.2] "
    "out=film",
    "detect": "detect recording=film out=found.npz",
    "track": "track recording=film detections=found.npz out=tracked.npz",
    "segment": "segment recording=film poses=tracked.npz out=parts.h5",
    "ingest": "ingest source=frames source.path=film out=ingested.h5",
    "train": f"train {' '.join(KEYS)} data=tosses",
    "evaluate": "evaluate data=tosses",
    "sweep": "evaluate --sweep gravity sweep.models=[cn,cnrp] sweep.values=[4.905,9.81] sweep.train=['epochs=2'] "
    "sweep.workers=2 sweep.seeds=[ROUND] data=tosses",
    "diagnose": f"diagnose data=tosses tosses=6 repeats=0 out=gap {FEW}",
    "audit": "audit tosses=6 cases=1 engines=[lcp] workers=1 seed=ROUND out=audited-ROUND",
    "export": "export format=urdf out=here/cube.urdf",
    "register": "register name=cube",
    "new-object": "new-object name=brickROUND box=[0.2,0.1,0.06] mass=0.8 out=brickROUND",
    "view": "view recording=film sheet=sheet.png",
}
"""Each needs what those before it make. ROUND is a number, for what would find nothing left to do."""

SMALL_DISK = """
set -e
mount -t tmpfs -o size={size}k tmpfs "$1"
cp -a "$2/." "$1"
cd "$1"
{then}
shift 2
set +e
"$@"
code=$?
rm -f "$FILLER"
cp -a . "$AFTER"
exit $code
"""
"""In a mount namespace of its own: a small disk with the project, filled up or read-only, and then the command."""
FILL = 'dd if=/dev/zero of="$FILLER" bs=1k 2> /dev/null || true; truncate -s -{free}k "$FILLER"'
READ_ONLY = 'mount -o remount,ro "$PWD"'


def command(name: str, turn: int = 1) -> list[str]:
    """The words of a command in a process of its own."""
    return [sys.executable, "-m", "pipelines.cli.app", *COMMANDS[name].replace("ROUND", str(turn)).split(), "--quiet"]


def start(name: str, folder: Path, turn: int = 1, **more: str) -> subprocess.Popen[str]:
    """A command that has been started in a project folder, with variables of its environment."""
    return subprocess.Popen(
        command(name, turn), cwd=folder, env=os.environ | more, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE,
        text=True, start_new_session=True,
    )  # fmt: skip


def hooked(folder: Path, code: str, **more: str) -> dict[str, str]:
    """The environment in which each Python process begins with some code."""
    folder.mkdir(exist_ok=True)
    (folder / "sitecustomize.py").write_text(code)
    return {"PYTHONPATH": os.pathsep.join([str(folder), os.environ.get("PYTHONPATH", ""), str(ROOT)]), **more}


def on_a_disk(name: str, project: Path, scratch: Path, *, free_kb: int | None) -> tuple[int, str, Path]:
    """Run a command on a disk of its own with a copy of the project.

    Args:
        name: The command.
        project: The project, which stays as it is.
        scratch: An empty folder.
        free_kb: Space that is left on the disk [KiB]; None to make it read-only.

    Returns:
        Its exit code, its words; and the folder with what then was on the disk.
    """
    disk, after = scratch / "disk", scratch / "after"
    disk.mkdir()
    after.mkdir()
    then = READ_ONLY if free_kb is None else FILL.format(free=free_kb)
    size = sum(path.stat().st_size // 1024 + 8 for path in project.rglob("*")) + 4 * (free_kb or 0) + 4096
    script = SMALL_DISK.format(size=size, then=then)
    if free_kb is None:
        script = script.replace('rm -f "$FILLER"\n', "")
    words = [str(disk), str(project), *command(name)]
    done = subprocess.run(
        ["unshare", "--user", "--map-root-user", "--mount", "sh", "-c", script, "sh", *words],
        env=os.environ | {"FILLER": str(disk / ".filler"), "AFTER": str(after)},
        stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True, timeout=600, check=False,
    )  # fmt: skip
    return done.returncode, done.stderr, after


def can_mount() -> bool:
    """Whether this user may mount a disk in a namespace of its own."""
    words = ["unshare", "--user", "--map-root-user", "--mount", "sh", "-c", "mount -t tmpfs tmpfs /mnt"]
    try:
        return subprocess.run(words, capture_output=True, check=False).returncode == 0
    except OSError:
        return False


def files(folder: Path) -> set[Path]:
    """What is visible of a project, but for files that SQLite makes and removes as it needs them."""
    hidden, passing = (".", "under_way"), ("-wal", "-shm", "-journal")
    return {
        path
        for path in folder.rglob("*")
        if path.is_file()
        and not path.name.endswith(passing)
        and not any(part.startswith(hidden) for part in path.relative_to(folder).parts)
    }


def check_all(folder: Path, before: set[Path]) -> None:
    """Nothing is lost, and everything is whole."""
    after = files(folder)
    assert before <= after, f"lost: {before - after}"
    for path in sorted(after):
        _check_whole(path)


def _check_whole(path: Path) -> None:
    """Reading a file by what it is; raises if it is damaged."""
    suffix = path.suffix
    if suffix == ".h5":
        read_dataset(path)
    elif suffix == ".npz":
        with np.load(path, allow_pickle=False) as archive:
            assert [archive[key] for key in archive.files]
    elif suffix == ".json":
        json.loads(path.read_text())
    elif suffix == ".pt":
        TrainedModel.load(path)
    elif suffix in (".png", ".jpg"):
        assert cv2.imread(str(path)) is not None
    elif suffix in (".xml", ".urdf"):
        load_object(path)
    elif suffix == ".html":
        assert path.read_text().rstrip().endswith("</html>")
    elif suffix == ".db":
        with closing(sqlite3.connect(path)) as store:
            assert store.execute("PRAGMA integrity_check").fetchone() == ("ok",)
