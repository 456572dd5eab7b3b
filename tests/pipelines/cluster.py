"""A Dask scheduler and workers as processes: in network namespaces where the machine allows, else on loopback."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path

NET = "10.88.214"
PORT = 18786
MODULE = [sys.executable, "-m"]
QUIET = ["--no-dashboard", "--dashboard-address", "127.0.0.1:0"]


def write_certificate(folder: Path) -> list[str]:
    """Write a certificate that is its own authority; returns the options of Dask's programs that name it."""
    from distributed.security import Security

    folder.mkdir(mode=0o700)
    made = Security.temporary().get_tls_config_for_role("scheduler")
    (folder / "cert.pem").write_text(made["cert"])
    (folder / "key.pem").write_text(made["key"])
    cert, key = str(folder / "cert.pem"), str(folder / "key.pem")
    return ["--tls-ca-file", cert, "--tls-cert", cert, "--tls-key", key]


@dataclass
class Cluster:
    """A running scheduler.

    Attributes:
        address: Where it listens.
        tls: Folder of the certificate that it, its workers and its clients hold.
        head: Begins a command that runs beside the scheduler.
        workers: Their processes.
        apart: Whether each worker has a network of its own.
    """

    address: str
    tls: Path
    head: list[str]
    workers: list[subprocess.Popen[bytes]]
    apart: bool


@contextmanager
def cluster(folder: Path, count: int = 2) -> Iterator[Cluster]:
    """A scheduler and workers with one thread each. They do not begin in `folder`: only paths are shared."""
    with ExitStack() as ends:
        apart = ends.enter_context(_namespaces(count))
        places = [_inside(f"tossid-{os.getpid()}-{i}") if apart else [] for i in range(count + 1)]
        host = f"{NET}.1" if apart else "127.0.0.1"
        address = f"tls://{host}:{PORT}"
        secure = write_certificate(folder / "tls")
        begun = ends.enter_context(_ended())
        start = {"cwd": folder, "stdout": subprocess.DEVNULL, "stderr": (folder / "cluster.log").open("ab")}
        scheduler = ["distributed.cli.dask_scheduler", "--host", host, "--port", str(PORT), *QUIET, *secure]
        begun.append(subprocess.Popen([*places[0], *MODULE, *scheduler], **start))
        worker = ["distributed.cli.dask_worker", address, "--nthreads", "1", "--no-nanny", *QUIET, *secure]
        begun += [
            subprocess.Popen([*place, *MODULE, *worker, "--local-directory", str(folder)], **start)
            for place in places[1:]
        ]
        yield Cluster(address, folder / "tls", places[0], begun[1:], apart)


@contextmanager
def _ended() -> Iterator[list[subprocess.Popen[bytes]]]:
    begun: list[subprocess.Popen[bytes]] = []
    try:
        yield begun
    finally:
        for process in reversed(begun):
            process.kill()
            process.wait(30)


def _inside(name: str) -> list[str]:
    return ["ip", "netns", "exec", name]


@contextmanager
def _namespaces(count: int) -> Iterator[bool]:
    """One for the scheduler, with a bridge, and one for each worker; False where the machine does not allow it."""
    names = [f"tossid-{os.getpid()}-{i}" for i in range(count + 1)]
    try:
        yield shutil.which("ip") is not None and _connected(names)
    finally:
        for name in names:
            _ip("netns", "del", name)


def _connected(names: list[str]) -> bool:
    head = names[0]
    done = _ip("netns", "add", head)
    done = done and _ip("-n", head, "link", "add", "bridge0", "type", "bridge")
    done = done and _ip("-n", head, "addr", "add", f"{NET}.1/24", "dev", "bridge0")
    done = done and _ip("-n", head, "link", "set", "bridge0", "up") and _ip("-n", head, "link", "set", "lo", "up")
    for i, name in enumerate(names[1:], start=2):
        done = done and _ip("netns", "add", name)
        done = done and _ip("-n", head, "link", "add", f"w{i}", "type", "veth", "peer", "name", "eth0", "netns", name)
        done = done and _ip("-n", head, "link", "set", f"w{i}", "master", "bridge0", "up")
        done = done and _ip("-n", name, "addr", "add", f"{NET}.{i}/24", "dev", "eth0")
        done = done and _ip("-n", name, "link", "set", "eth0", "up") and _ip("-n", name, "link", "set", "lo", "up")
    return done


def _ip(*args: str) -> bool:
    try:
        return subprocess.run(["ip", *args], capture_output=True, timeout=20).returncode == 0
    except (OSError, subprocess.TimeoutExpired):
        return False


def wait_for(condition, seconds: float) -> bool:  # type: ignore[no-untyped-def]
    """Whether it comes true in time."""
    deadline = time.monotonic() + seconds
    while time.monotonic() < deadline:
        if condition():
            return True
        time.sleep(0.02)
    return False
