"""Commands as processes of their own, with a clock that jumps back, or on a disk that is full or read-only."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

CLOCK = """
import os, time
_time, _time_ns, _start = time.time, time.time_ns, time.monotonic()
_after, _back = float(os.environ["JUMP_AFTER_S"]), int(os.environ["JUMP_BACK_S"])
def _jump():
    return _back if time.monotonic() - _start > _after else 0
time.time = lambda: _time() - _jump()
time.time_ns = lambda: _time_ns() - _jump() * 10**9
"""
"""As `sitecustomize.py`: the clock of a Python process, and of its children, jumps back once."""

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


def tossid(folder: Path, *args: str, **more: str) -> subprocess.Popen[str]:
    """A command that has been started in a project folder.

    Args:
        folder: The project.
        *args: The command and its keys.
        **more: Variables of its environment.
    """
    return subprocess.Popen(
        [sys.executable, "-m", "pipelines.cli.app", *args, "--quiet"],
        cwd=folder, env=os.environ | more, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip


def jumping(folder: Path, after_s: float, back_s: int = 3600) -> dict[str, str]:
    """The environment in which the clock jumps back.

    Args:
        folder: Where the hook is written.
        after_s: Time from a process's start to the jump [s].
        back_s: How far the clock jumps [s].
    """
    folder.mkdir(exist_ok=True)
    (folder / "sitecustomize.py").write_text(CLOCK)
    path = os.pathsep.join([str(folder), os.environ.get("PYTHONPATH", ""), str(Path(__file__).parents[3])])
    return {"PYTHONPATH": path, "JUMP_AFTER_S": str(after_s), "JUMP_BACK_S": str(back_s)}


def on_a_disk(
    project: Path, scratch: Path, *args: str, free_kb: int | None
) -> tuple[subprocess.CompletedProcess[str], Path]:
    """Run a command on a disk of its own with a copy of the project.

    Args:
        project: The project, which stays as it is.
        scratch: A folder that is empty or not there yet.
        *args: The command and its keys.
        free_kb: Space that is left on the disk [KiB]; None to make it read-only.

    Returns:
        How the command ended; and the folder with what then was on the disk.
    """
    disk, after = scratch / "disk", scratch / "after"
    disk.mkdir(parents=True)
    after.mkdir()
    then = READ_ONLY if free_kb is None else FILL.format(free=free_kb)
    size = sum(path.stat().st_size // 1024 + 8 for path in project.rglob("*")) + 4 * (free_kb or 0) + 4096
    script = SMALL_DISK.format(size=size, then=then)
    if free_kb is None:
        script = script.replace('rm -f "$FILLER"\n', "")
    command = [str(disk), str(project), sys.executable, "-m", "pipelines.cli.app", *args, "--quiet"]
    done = subprocess.run(
        ["unshare", "--user", "--map-root-user", "--mount", "sh", "-c", script, "sh", *command],
        env=os.environ | {"FILLER": str(disk / ".filler"), "AFTER": str(after)},
        stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True, timeout=600, check=False,
    )  # fmt: skip
    return done, after


def can_mount() -> bool:
    """Whether this user may mount a disk in a namespace of its own."""
    try:
        made = subprocess.run(
            ["unshare", "--user", "--map-root-user", "--mount", "sh", "-c", "mount -t tmpfs tmpfs /mnt"],
            capture_output=True, check=False,
        )  # fmt: skip
    except OSError:
        return False
    return made.returncode == 0
