"""Wrong calls are one line, and the version is printed."""

from __future__ import annotations

from pathlib import Path

import pytest

from pipelines.cli import app
from tests.pipelines.conftest import Run, one_line


@pytest.mark.parametrize(
    ("args", "words"),
    [
        (["ingest", "soruce=tum"], "Did you mean 'source'?"),
        (["ingest", "source=tom"], "Did you mean 'tum'?"),
        (["ingest", "seed=x"], "expected a whole number"),
        (["ingest", "+seed=1"], "cannot be added"),
        (["ingest", "~seed"], "cannot be removed"),
        (["ingest", "tum"], "Did you mean 'source=tum'?"),
        (["ingest", "source=tum"], "source.path: is needed"),
        (["ingest", "--seed", "3"], "seed=…"),
        (["ingest", "--jsn"], "Did you mean '--json'?"),
        (["ingset"], "Did you mean 'ingest'?"),
        (["info"], "FILE"),
        (["info", "nowhere.h5"], "nowhere.h5: no such file"),
        (["--nothing"], "--nothing"),
        (["--version", "--quiet"], "--quiet: no such option. It stands after a command: tossid COMMAND --quiet."),
        (["-q"], "-q: no such option. It stands after a command: tossid COMMAND -q."),
        (["--versoin"], "Did you mean '--version'?"),
        (["info", "--version"], "It stands alone: tossid --version."),
        (["ingest"], "no recording here"),
        (
            ["ingest", "source=tum", "source.path=nowhere"],
            "nowhere: no such file or folder; source.path names",
        ),
    ],
)
def test_a_wrong_call_is_one_line_and_exit_2(
    project: Path, capfd: pytest.CaptureFixture[str], args: list[str], words: str
) -> None:
    assert app.run(args) == 2
    out, err = capfd.readouterr()
    assert out == ""
    assert words in one_line(err)
    assert "Traceback" not in err


def test_version(tossid: Run) -> None:
    assert tossid("--version").stdout.startswith("tossid 0.")
