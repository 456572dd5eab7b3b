"""Between the command line and a command: the result alone on standard output, nothing half done."""

from __future__ import annotations

import json
import logging
import os
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from pipelines.cli import app
from pipelines.cli.console import Console
from tests.pipelines.conftest import one_line


def test_json_is_all_there_is_on_standard_output(command: SimpleNamespace, capfd: pytest.CaptureFixture[str]) -> None:
    import numpy as np

    def noisy(path: Path, console: Console) -> dict[str, Any]:
        print("a library's chatter")
        os.write(1, b"a C library's chatter\n")
        subprocess.run(["echo", "a child's chatter"], check=True)
        console.say("for people")
        console.table(["name", "value"], [["a", 1.0]])
        console.warn("careful")
        return {"path": path.file, "mean": np.float64(2.5), "bad": float("nan"), "list": np.arange(3), "flag": np.True_}

    command.does = noisy
    assert app.run(["info", "x", "--json"]) == 0
    out, err = capfd.readouterr()
    assert json.loads(out) == {"path": "x", "mean": 2.5, "bad": None, "list": [0, 1, 2], "flag": True}
    for words in (
        "a library's chatter",
        "a C library's chatter",
        "a child's chatter",
        "for people",
        "warning: careful",
    ):
        assert words in err
    assert app.run(["info", "x"]) == 0
    assert capfd.readouterr().out == ""


@pytest.mark.parametrize("number", ["SIGINT", "SIGTERM"])
def test_an_interrupted_command_tidies_up(project: Path, number: str) -> None:
    script = f"""
import os, signal, sys
from pathlib import Path
from pipelines.cli import app
from pipelines.cli import call as calling
from tossid.outputs import output_file
def write(path, console):
    with output_file(path.file) as temporary:
        temporary.write_text("half")
        os.kill(os.getpid(), signal.{number})
        import time; time.sleep(30)
calling._runner = lambda command: write
sys.exit(app.run(["info", "a.h5"]))
"""
    (project / "a.h5").write_text("old")
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, cwd=project, timeout=60)
    assert done.returncode == 130
    assert "interrupted" in one_line(done.stderr)
    assert (project / "a.h5").read_text() == "old"
    assert [path.name for path in project.iterdir()] == ["a.h5"]


def test_what_the_library_logs_is_said_once(command: SimpleNamespace, capfd: pytest.CaptureFixture[str]) -> None:
    def logs(path: Any, console: Console) -> dict[str, Any]:
        for _ in range(2):
            logging.getLogger("tossid.objects").info("thing.xml states friction 0.9")
            logging.getLogger("tossid.objects").warning("0.18 is a guess")
        logging.getLogger("elsewhere").warning("not ours")
        return {}

    command.does = logs
    assert app.run(["info", "x"]) == 0
    said = capfd.readouterr().err
    assert (said.count("thing.xml states"), said.count("warning: 0.18 is"), said.count("0.18 is")) == (1, 1, 1)
    assert app.run(["info", "x", "--quiet"]) == 0
    said = capfd.readouterr().err
    assert (said.count("thing.xml states"), said.count("0.18 is")) == (0, 1)
    assert not logging.getLogger("tossid").handlers
