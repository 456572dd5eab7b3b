"""No password of a tracking address is in what is printed, logged or written."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from pipelines.tracking.addresses import redacted, without_password
from tests.pipelines.disturbed import COMMANDS
from tests.pipelines.processes import Server, wait_for


@pytest.mark.parametrize(
    ("uri", "shown"),
    [
        ("http://ann:s3cret@lab:5000", "http://ann:***@lab:5000"),
        ("postgresql+psycopg2://ann:p%40ss%2Fw@lab/runs", "postgresql+psycopg2://ann:***@lab/runs"),
        ("postgresql://ann:p@ss/w@lab/runs", "postgresql://ann:***@lab/runs"),
        ("postgresql://lab/runs?user=ann&password=s3cret", "postgresql://lab/runs?user=ann&password=***"),
        ("http://lab:5000", "http://lab:5000"),
        ("postgresql://ann@lab/runs", "postgresql://ann@lab/runs"),
        ("sqlite:////data/a@b/mlflow.db", "sqlite:////data/a@b/mlflow.db"),
        ("", ""),
    ],
)
def test_an_address_without_its_password(uri: str, shown: str) -> None:
    assert without_password(uri) == shown


@pytest.mark.parametrize("uri", ["http://ann:pl%40nt%2Fed@lab:5000", "http://ann:planted@lab:5000"])
def test_a_text_about_an_address(uri: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("MLFLOW_TRACKING_URI", uri)
    text = f"API request to {uri}/api failed; mail ann@lab; login failed for 'pl@nt/ed' or 'planted'"
    shown = redacted(text)
    assert "API request to http://ann:***@lab:5000/api failed; mail ann@lab;" in shown
    assert "ed@lab" not in shown
    monkeypatch.setenv("MLFLOW_TRACKING_TOKEN", "tok-12345")
    assert redacted("Authorization: Bearer tok-12345") == "Authorization: Bearer ***"
    assert ("planted" in shown) == ("%40" in uri)
    assert ("pl@nt/ed" in shown) == ("%40" not in uri)


ENCODED = "s3%40cr%2Fet-9f3a"
PLANTED = (b"et-9f3a", b"s3@cr", b"s3%40cr")
"""Parts that would give it away, in the forms that it may take."""
UNDER_WAY = """
import sys, time
from pipelines.cli.failures import guarded
from pipelines.tracking.run import tracked_run
def work():
    with tracked_run("cut", {"seed": 1}, command="train") as run:
        open("ready", "w").close()
        while open("ready").read() != "go":
            time.sleep(0.1)
        run.tag("note", "later")
sys.exit(guarded(work, "work"))
"""


def called(folder: Path, uri: str, *args: str) -> subprocess.CompletedProcess[bytes]:
    quick = {"MLFLOW_HTTP_REQUEST_MAX_RETRIES": "0", "MLFLOW_HTTP_REQUEST_TIMEOUT": "20"}
    environment = os.environ | {"MLFLOW_TRACKING_URI": uri, "TMPDIR": str(folder / "tmp"), **quick}
    return subprocess.run([sys.executable, *args], cwd=folder, env=environment, capture_output=True, timeout=600)


def told(folder: Path) -> list[str]:
    """Files in which a part of the password stands."""
    files = [path for path in folder.rglob("*") if path.is_file()]
    return [str(path) for path in files if any(part in path.read_bytes() for part in PLANTED)]


@pytest.mark.slow
def test_no_command_tells_the_password(beside: Path, tmp_path_factory: pytest.TempPathFactory) -> None:
    place = tmp_path_factory.mktemp("server")
    (beside / "tmp").mkdir()
    server = Server(place)
    uri = server.uri.replace("http://", f"http://ann:{ENCODED}@")
    said: dict[str, bytes] = {}

    def tossid(*args: str, code: int = 0) -> None:
        done = called(beside, uri, "-m", "pipelines.cli.app", *args)
        assert done.returncode == code, (args, done.stderr.decode())
        said[" ".join(args)] = done.stdout + done.stderr

    try:
        server.start()
        for command in COMMANDS.values():
            tossid(*command.replace("ROUND", "1").split())
        tossid("info", "ingested.h5", "--json")
        tossid("doctor", "--json")
        tossid("evaluate", "run=models:/cube/1", "--json")
        assert list((beside / "tmp").glob("tossid-run-*")) == []
        environment = os.environ | {"MLFLOW_TRACKING_URI": uri, "MLFLOW_HTTP_REQUEST_MAX_RETRIES": "0"}
        with subprocess.Popen(
            [sys.executable, "-c", UNDER_WAY], cwd=beside, env=environment, stderr=subprocess.PIPE
        ) as running:
            assert wait_for((beside / "ready").exists, 60)
            server.stop()
            (beside / "ready").write_text("go")
            said["a run whose server dies"] = running.communicate(timeout=120)[1]
        assert b"MLflow's store refuses" in said["a run whose server dies"]
        tossid("doctor")
        tossid("train", "model=cn", "epochs=1", "data=tosses", "--debug", code=2)
    finally:
        server.stop()
    assert [name for name, text in said.items() if any(part in text for part in PLANTED)] == []
    assert told(beside) == []
    assert told(place) == []


def test_a_bugs_traceback_does_not_tell_it(project: Path) -> None:
    """Where an error that nobody expected has the address in its text."""
    uri = f"http://ann:{ENCODED}@127.0.0.1:9"
    script = """
import os, sys
from pipelines.cli import app
from pipelines.commands import doctor
def fail(*_):
    raise RuntimeError(f"API request to {os.environ['MLFLOW_TRACKING_URI']}/api failed for 's3@cr/et-9f3a'")
doctor.run = fail
sys.exit(app.run(["doctor", *sys.argv[1:]]))
"""
    for args in ([], ["--debug"]):
        done = called(project, uri, "-c", script, *args)
        assert done.returncode == 1
        assert b"ann:***@127.0.0.1:9" in done.stderr
        assert not any(part in done.stdout + done.stderr for part in PLANTED)
    assert list((project / "outputs/logs").glob("*.log"))
    assert told(project) == []
