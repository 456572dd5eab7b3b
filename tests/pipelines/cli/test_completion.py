"""What Tab offers, as bash and zsh ask for it."""

from __future__ import annotations

import shutil
import subprocess
import sys

import pytest

from pipelines.cli import app


def offered(monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str], *words: str) -> list[str]:
    """What bash gets for a line of these words, of which the last is under way."""
    monkeypatch.setenv("COMP_WORDS", "\n".join(words))
    monkeypatch.setenv("COMP_CWORD", str(len(words) - 1))
    monkeypatch.setenv("_TOSSID_COMPLETE", "complete_bash")
    with pytest.raises(SystemExit):
        app.run([])
    return capfd.readouterr().out.split("\n")[:-1]


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (["tossid", "tra"], ["track", "train"]),
        (["tossid", "train", "optim"], ["optimizer=lbfgs", "optimizer=adam"]),
        (["tossid", "train", "pat"], ["patience=", "patience=<a whole number of at least 1>"]),
        (["tossid", "train", "model", "=", "cnrp"], ["cnrp", "cnrp_world", "cnrpi"]),
        (["tossid", "train", "restart", "="], ["true", "false"]),
        (["tossid", "train", "--q"], ["--quiet"]),
        (
            ["tossid", "evaluate", "launcher=dask", "launcher."],
            ["launcher.address=", "launcher.tls=", "launcher.insecure=", "launcher.wait_s="],
        ),
        (["tossid", "train", "nothing"], [""]),
    ],
)
def test_bash(
    monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str], words: list[str], expected: list[str]
) -> None:
    assert offered(monkeypatch, capfd, *words) == expected


def test_zsh(monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setenv("_TYPER_COMPLETE_ARGS", "tossid train model=cnrp")
    monkeypatch.setenv("_TOSSID_COMPLETE", "complete_zsh")
    with pytest.raises(SystemExit):
        app.run([])
    assert '"model=cnrp"\n"model=cnrp_world"\n"model=cnrpi"' in capfd.readouterr().out


@pytest.mark.skipif(shutil.which("bash") is None, reason="no bash here")
def test_the_script_works_in_bash() -> None:
    script = f"""
    tossid() {{ {sys.executable} -m pipelines.cli.app "$@"; }}
    export -f tossid
    eval "$({sys.executable} -c 'from pipelines.cli import app; app.main(["--show-completion", "bash"])')"
    printf '#!/bin/sh\\nexec {sys.executable} -m pipelines.cli.app "$@"\\n' > "$TMP/tossid"; chmod +x "$TMP/tossid"
    COMP_WORDS=(tossid synth); COMP_CWORD=1
    _tossid_completion "$TMP/tossid"
    echo "${{COMPREPLY[@]}}"
    """
    done = subprocess.run(
        ["bash", "-c", f'TMP=$(mktemp -d); {script}; rm -r "$TMP"'], capture_output=True, text=True, timeout=60
    )
    assert done.stdout.split() == ["synthesize"], done.stderr
