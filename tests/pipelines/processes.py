"""An MLflow server, and Dask with its workers, as processes on loopback that a test throws away."""

from __future__ import annotations

import os
import socket
import subprocess
import sys
import time
import urllib.request
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path

PORT = 18786
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
        workers: Their processes.
    """

    address: str
    tls: Path
    workers: list[subprocess.Popen[bytes]]


@contextmanager
def cluster(folder: Path, count: int = 2) -> Iterator[Cluster]:
    """A scheduler and workers with one thread each. They do not begin in `folder`: only paths are shared."""
    address = f"tls://127.0.0.1:{PORT}"
    secure = write_certificate(folder / "tls")
    worker = ["dask_worker", address, "--nthreads", "1", "--no-nanny", "--local-directory", str(folder)]
    with ExitStack() as ends, (folder / "cluster.log").open("ab") as log:
        begun = []
        for program in (["dask_scheduler", "--host", "127.0.0.1", "--port", str(PORT)], *[worker] * count):
            words = [sys.executable, "-m", f"distributed.cli.{program[0]}", *program[1:], *QUIET, *secure]
            begun.append(ends.enter_context(subprocess.Popen(words, cwd=folder, stdout=subprocess.DEVNULL, stderr=log)))
            ends.callback(begun[-1].kill)
        yield Cluster(address, folder / "tls", begun[1:])


def wait_for(condition: Callable[[], object], seconds: float) -> bool:
    """Whether it comes true in time."""
    deadline = time.monotonic() + seconds
    while time.monotonic() < deadline:
        if condition():
            return True
        time.sleep(0.02)
    return False


def free_port() -> int:
    with socket.socket() as found:
        found.bind(("127.0.0.1", 0))
        return int(found.getsockname()[1])


class Server:
    """An MLflow server that can be stopped and started again at the same address."""

    def __init__(self, folder: Path) -> None:
        self.port = free_port()
        self.uri = f"http://127.0.0.1:{self.port}"
        self._folder = folder
        self._process: subprocess.Popen[bytes] | None = None

    def start(self) -> None:
        args = ["--artifacts-destination", str(self._folder / "artifacts")]
        args += ["--host", "127.0.0.1", "--port", str(self.port), "--workers", "1"]
        environment = {**os.environ, "MLFLOW_DISABLE_TELEMETRY": "true", "MLFLOW_SERVER_ENABLE_JOB_EXECUTION": "false"}
        environment.pop("MLFLOW_TRACKING_URI", None)
        environment["MLFLOW_BACKEND_STORE_URI"] = f"sqlite:///{self._folder / 'server.db'}"
        self._process = subprocess.Popen(
            [sys.executable, "-m", "mlflow", "server", *args],
            stdout=(self._folder / "server.log").open("ab"), stderr=subprocess.STDOUT, cwd=self._folder,
            env=environment, start_new_session=True,
        )  # fmt: skip
        assert wait_for(self._answers, 180), (self._folder / "server.log").read_text()[-2000:]

    def stop(self) -> None:
        """At once, as a machine that goes down."""
        if self._process is not None:
            os.killpg(self._process.pid, 9)
            self._process.wait(30)
            self._process = None

    def _answers(self) -> bool:
        try:
            with urllib.request.urlopen(f"{self.uri}/health", timeout=2) as answer:
                return bool(answer.status == 200)
        except OSError:
            return False
