"""Dependencies are checked in any case, and audited: by the service, by a copy, or not without saying so."""

from __future__ import annotations

import datetime
import hashlib
import json
import subprocess
import sys
import zipfile
from importlib import metadata
from pathlib import Path
from typing import Any

import pytest

from pipelines.tools import dependencies
from tossid.errors import FileError, InputError

TODAY = datetime.date.today()


@pytest.fixture
def called(monkeypatch: pytest.MonkeyPatch) -> dict[str, Any]:
    """What is run, with statuses to answer with; the service is out of reach, unless it is said to be there."""
    known: dict[str, Any] = {"pip": 0, "pip_audit": 0, "ran": [], "unreachable": "no route"}

    def run(command: list[str], *, check: bool) -> subprocess.CompletedProcess[bytes]:
        assert command[:2] == [sys.executable, "-m"]
        known["ran"].append(command[2])
        return subprocess.CompletedProcess(command, known[command[2]])

    monkeypatch.setattr(dependencies.subprocess, "run", run)
    monkeypatch.setattr(dependencies, "_unreachable", lambda: known["unreachable"])
    return known


@pytest.fixture
def locks(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    (tmp_path / "cpu.txt").write_text("numpy==2.4.1\n")
    monkeypatch.setattr(dependencies, "LOCKS", tmp_path)
    return tmp_path


def exempt(locks: Path, *, days: int = 30, sha256: str | None = None) -> None:
    sha256 = sha256 or hashlib.sha256((locks / "cpu.txt").read_bytes()).hexdigest()
    until = TODAY + datetime.timedelta(days=days)
    since = TODAY - datetime.timedelta(days=60)
    text = f'reason = "no network"\nsince = {since}\nuntil = {until}\n[locks]\n"cpu.txt" = "{sha256}"\n'
    (locks / dependencies.EXEMPTION).write_text(text)


def database(path: Path, *entries: dict[str, Any]) -> str:
    with zipfile.ZipFile(path, "w") as copy:
        for number, content in enumerate(entries):
            copy.writestr(f"{number}.json", json.dumps(content))
    return str(path)


def entry(name: str, **affected: Any) -> dict[str, Any]:
    about = {"package": {"ecosystem": "PyPI", "name": name}, **affected}
    return {"id": f"PYSEC-{name}", "modified": "2026-11-01T00:00:00Z", "affected": [about]}


def test_what_does_not_fit_together_fails(called: dict[str, Any]) -> None:
    called["pip"] = 1
    with pytest.raises(InputError, match="do not fit together"):
        dependencies.main()
    assert called["ran"] == ["pip"]


def test_the_service_decides(called: dict[str, Any]) -> None:
    called["unreachable"] = ""
    dependencies.main("not read")
    assert called["ran"] == ["pip", "pip_audit"]
    called["pip_audit"] = 1
    with pytest.raises(InputError, match="known vulnerabilities"):
        dependencies.main()


def test_out_of_reach_a_copy_decides(
    called: dict[str, Any], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    version = metadata.version("numpy")
    fixed = [{"introduced": "0"}, {"fixed": "1.0"}]
    other = {**entry("numpy", versions=[version]), "withdrawn": "2026-11-02T00:00:00Z"}
    well = entry("NumPy", versions=["0.1"], ranges=[{"type": "ECOSYSTEM", "events": fixed}])
    dependencies.main(database(tmp_path / "all.zip", well, other, entry("no-such-package", versions=[version])))
    assert "3 entries, the newest of 2026-11-01" in " ".join(capsys.readouterr().err.split())
    bad = entry("NumPy", ranges=[{"type": "ECOSYSTEM", "events": [{"introduced": "1.0"}]}])
    with pytest.raises(InputError, match=rf"numpy {version}: PYSEC-NumPy"):
        dependencies.main(database(tmp_path / "all.zip", well, bad))


@pytest.mark.parametrize("content", [b"", b"no zip"])
def test_no_copy_is_no_copy(called: dict[str, Any], tmp_path: Path, content: bytes) -> None:
    (tmp_path / "all.zip").write_bytes(content)
    with pytest.raises(FileError, match="no readable copy"):
        dependencies.main(str(tmp_path / "all.zip"))
    with pytest.raises(FileError, match="no entries"):
        dependencies.main(database(tmp_path / "all.zip"))


@pytest.mark.parametrize(
    ("version", "affected"),
    [("0.9", False), ("1.0", True), ("1.9", True), ("2.0", False), ("3.1", True), ("3.2", False)],
)
def test_ranges(version: str, affected: bool) -> None:
    events = [{"introduced": "1.0"}, {"fixed": "2.0"}, {"introduced": "3.0"}, {"last_affected": "3.1"}]
    assert dependencies.is_affected(version, {"ranges": [{"type": "ECOSYSTEM", "events": events}]}) == affected


def test_without_service_and_copy_it_fails(called: dict[str, Any], locks: Path) -> None:
    with pytest.raises(
        InputError, match=r"not audited: api\.osv\.dev cannot be reached \(no route\), and there is no copy"
    ):
        dependencies.main()


def test_an_exemption_is_loud(called: dict[str, Any], locks: Path, capsys: pytest.CaptureFixture[str]) -> None:
    exempt(locks)
    dependencies.main()
    said = " ".join(capsys.readouterr().err.split())
    assert "warning: NOT AUDITED: api.osv.dev cannot be reached (no route)" in said
    assert said.endswith(": no network")


def test_an_exemption_ends_and_is_of_these_locks(called: dict[str, Any], locks: Path) -> None:
    exempt(locks, days=-1)
    with pytest.raises(InputError, match=r"unaudited\.toml holds from .* to"):
        dependencies.main()
    exempt(locks, sha256="0" * 64)
    with pytest.raises(InputError, match=r"unaudited\.toml is of another cpu\.txt"):
        dependencies.main()
    (locks / dependencies.EXEMPTION).write_text("reason = 1")
    with pytest.raises(FileError, match="expected reason, since, until"):
        dependencies.main()
