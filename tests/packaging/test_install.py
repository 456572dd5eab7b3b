"""`make setup` says how far it is while pip works, and gives pip's exit status on."""

from __future__ import annotations

import hashlib
import runpy
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

CHOOSE = Path(__file__).parents[2] / "requirements" / "choose.py"
SCRIPT = Path(__file__).parents[2] / "requirements" / "install.py"


@pytest.mark.parametrize("status", [0, 3])
def test_a_slow_installation_is_reported(status: int, monkeypatch: pytest.MonkeyPatch, capfd: Any) -> None:
    script = runpy.run_path(str(SCRIPT))["main"]
    asked = []
    begin = subprocess.Popen

    def slow(command: list[str]) -> subprocess.Popen[bytes]:
        asked.append(command)
        return begin([sys.executable, "-c", f"import time; time.sleep(0.5); raise SystemExit({status})"])

    monkeypatch.setitem(script.__globals__, "EVERY_S", 0.05)
    monkeypatch.setitem(script.__globals__, "megabytes", lambda: 7.0)
    monkeypatch.setattr(subprocess, "Popen", slow)
    assert script(["torch"]) == status
    assert asked[0][-3:] == ["install", "--quiet", "torch"]
    lines = capfd.readouterr().err.splitlines()
    assert lines[0].startswith("installing packages: 0 MB in")
    assert lines[-1].startswith("installed 0 MB in" if status == 0 else "installing packages")


def test_a_part_of_a_lock_is_installed_with_its_hashes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    script = runpy.run_path(str(SCRIPT))
    heads = ("a==1", "a-b==2 ; sys_platform == 'linux'", "c==3")
    lock = "".join(f"{head} \\\n    --hash=sha256:{k}0 \\\n    --hash=sha256:{k}1\n" for k, head in enumerate(heads))
    (tmp_path / "lock.txt").write_text(lock)
    (tmp_path / "names").write_text("a-b\nc\n")
    given: list[str] = []

    class Pip:
        def __init__(self, command: list[str]) -> None:
            given.append(Path(command[-1]).read_text())

        def __enter__(self) -> Pip:
            return self

        def __exit__(self, *_: object) -> None:
            pass

        def wait(self, _: float) -> int:
            return 0

    monkeypatch.setattr(subprocess, "Popen", Pip)
    assert script["main"](["--only", str(tmp_path / "names"), str(tmp_path / "lock.txt"), "--require-hashes"]) == 0
    assert given == [lock[lock.index("a-b") :]]


@pytest.mark.parametrize("said", [{"hashes": {"sha256": "1f"}}, {}])
def test_the_build_of_torch_is_known_though_pip_says_no_hash(said: dict[str, Any], tmp_path: Path) -> None:
    """pip 23.0, which Debian 12 has, gives none of a file on this machine."""
    (tmp_path / "a torch.whl").write_bytes(b"torch")
    download = {"archive_info": said, "url": (tmp_path / "a torch.whl").as_uri()}
    expected = said["hashes"]["sha256"] if said else hashlib.sha256(b"torch").hexdigest()
    assert runpy.run_path(str(CHOOSE))["sha256_of"](download) == expected
