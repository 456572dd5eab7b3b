"""PostgreSQL and an MLflow server as processes of their own, on loopback, in a folder that the test throws away."""

from __future__ import annotations

import os
import runpy
import shutil
import socket
import subprocess
import sys
import tempfile
import urllib.request
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from tests.pipelines.cluster import wait_for


def free_port() -> int:
    with socket.socket() as found:
        found.bind(("127.0.0.1", 0))
        return int(found.getsockname()[1])


def _programs() -> Path | None:
    """Where initdb and pg_ctl are."""
    found = shutil.which("initdb")
    folders = [Path(found).resolve().parent] if found else sorted(Path("/usr/lib/postgresql").glob("*/bin"))
    return folders[-1] if folders and (folders[-1] / "initdb").exists() else None


@contextmanager
def postgres(password: str = "") -> Iterator[str]:
    """A database's address; skips where PostgreSQL cannot be started. It asks for the password, if one is given."""
    programs = _programs()
    if programs is None:
        pytest.skip("no PostgreSQL here (initdb, pg_ctl): apt install postgresql")
    pytest.importorskip("psycopg2", reason="psycopg2 is an extra: pip install -e '.[server]'")
    as_user = []
    data, port = Path(tempfile.mkdtemp(prefix="tossid-pg-")), free_port()  # pytest's folders are for their owner alone
    if os.geteuid() == 0:  # PostgreSQL refuses root
        if shutil.which("runuser") is None or subprocess.run(["id", "postgres"], capture_output=True).returncode:
            pytest.skip("PostgreSQL does not run as root, and there is no user postgres to run it")
        as_user = ["runuser", "-u", "postgres", "--"]
        shutil.chown(data, "postgres")

    def call(*args: str) -> str:
        done = subprocess.run([*as_user, *args], capture_output=True, text=True, cwd="/", timeout=120)
        return done.stderr.strip()[-300:] if done.returncode else ""

    (data / "password").write_text(password)
    asks = ["--auth=scram-sha-256", f"--pwfile={data}/password"] if password else ["--auth=trust"]
    problem = call(str(programs / "initdb"), "-D", f"{data}/db", "-U", "tossid", *asks, "--no-sync")
    options = f"-p {port} -c listen_addresses=127.0.0.1 -c unix_socket_directories={data} -c fsync=off"
    start = ["-D", f"{data}/db", "-l", f"{data}/log", "-w", "-o", options, "start"]
    problem = problem or call(str(programs / "pg_ctl"), *start)
    try:
        if problem:
            pytest.skip(f"PostgreSQL does not start here: {problem}")
        yield address(password, user="tossid", host="127.0.0.1", port=port, name="postgres")
    finally:
        call(str(programs / "pg_ctl"), "-D", f"{data}/db", "-m", "immediate", "stop")
        shutil.rmtree(data, ignore_errors=True)


def address(password: str, **more: Any) -> str:
    """As docs/server/start.py has it."""
    start = runpy.run_path(str(Path(__file__).parents[2] / "docs" / "server" / "start.py"))
    return str(start["address"](password, **more))


class Server:
    """An MLflow server that can be stopped and started again at the same address."""

    def __init__(self, folder: Path, database: str) -> None:
        self.port = free_port()
        self.uri = f"http://127.0.0.1:{self.port}"
        self._folder, self._database = folder, database
        self._process: subprocess.Popen[bytes] | None = None

    def start(self) -> None:
        args = ["--artifacts-destination", str(self._folder / "artifacts")]
        args += ["--host", "127.0.0.1", "--port", str(self.port), "--workers", "1"]
        environment = {**os.environ, "MLFLOW_DISABLE_TELEMETRY": "true", "MLFLOW_SERVER_ENABLE_JOB_EXECUTION": "false"}
        environment.pop("MLFLOW_TRACKING_URI", None)
        environment["MLFLOW_BACKEND_STORE_URI"] = self._database
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
