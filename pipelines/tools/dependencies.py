"""`make dependencies`: what is installed fits together, and has no vulnerability that is known of.

Known vulnerabilities are OSV's. osv.dev is asked over the network. Where it cannot be reached, a copy of its database
is read (`make OSV=FILE dependencies`). Where there is no copy either, this fails, unless requirements/unaudited.toml
says for exactly these locks, with a reason and an end, that they are used without an audit. That is warned of each time
(ADR 18).
"""

from __future__ import annotations

import datetime
import hashlib
import json
import socket
import subprocess
import sys
import tomllib
import zipfile
from collections.abc import Iterator
from importlib import metadata
from pathlib import Path
from typing import Any

from packaging.utils import canonicalize_name
from packaging.version import InvalidVersion, Version

from pipelines.cli.console import Console
from pipelines.cli.failures import guarded
from tossid.errors import FileError, InputError

SERVICE = ("api.osv.dev", 443)
SECONDS = 5.0
"""How long the service may take to answer at all."""
LOCKS = Path(__file__).resolve().parents[2] / "requirements"
EXEMPTION = "unaudited.toml"
_COPY = "https://osv-vulnerabilities.storage.googleapis.com/PyPI/all.zip"
"""Where OSV publishes its database for a copy to be made."""


def main(copy: str = "") -> None:
    """Check, then audit.

    Args:
        copy: A copy of OSV's database for PyPI, a zip of JSON files; "" for none.

    Raises:
        InputError: Something does not fit, is vulnerable, or could not be audited.
        FileError: The copy or the exemption cannot be read.
    """
    if subprocess.run([sys.executable, "-m", "pip", "check"], check=False).returncode:
        raise InputError("installed packages do not fit together; make distclean setup")
    unreachable = _unreachable()
    if not unreachable:
        # ours is installed from its folder, and not on an index
        audit = ["-m", "pip_audit", "--vulnerability-service", "osv", "--skip-editable", "--progress-spinner", "off"]
        if subprocess.run([sys.executable, *audit], check=False).returncode:
            raise InputError("installed packages have known vulnerabilities, or could not be audited")
    elif copy:
        _audit_by_copy(Path(copy))
    else:
        _exempted(f"{SERVICE[0]} cannot be reached ({unreachable})", LOCKS, datetime.date.today())


def _unreachable() -> str:
    """Why the service cannot be asked; "" if it can."""
    try:
        socket.create_connection(SERVICE, SECONDS).close()
    except OSError as error:
        return str(error)
    return ""


# ---------------------------------------------------------------- a copy of the database


def _audit_by_copy(path: Path) -> None:
    installed = {canonicalize_name(one.name): one.version for one in metadata.distributions()}
    found, count, newest = [], 0, ""
    for entry in _entries(path):
        count, newest = count + 1, max(newest, str(entry.get("modified", "")))
        for affected in [] if "withdrawn" in entry else entry.get("affected", []):
            package = affected.get("package", {})
            name = canonicalize_name(package.get("name", ""))
            if package.get("ecosystem") == "PyPI" and name in installed and is_affected(installed[name], affected):
                found.append(f"{name} {installed[name]}: {entry['id']}")
    if not count:
        raise FileError(path, f"holds no entries of OSV; expected a copy of {_COPY}")
    if found:
        raise InputError(f"known vulnerabilities: {'; '.join(sorted(set(found)))}")
    Console().say(f"audited {len(installed)} packages by {path}: {count} entries, the newest of {newest[:10]}")


def _entries(path: Path) -> Iterator[dict[str, Any]]:
    try:
        with zipfile.ZipFile(path) as copy:
            for name in copy.namelist():
                yield json.loads(copy.read(name))
    except (OSError, ValueError, zipfile.BadZipFile) as error:
        raise FileError(path, f"no readable copy of OSV's database ({error}); expected one of {_COPY}") from error


def is_affected(version: str, affected: dict[str, Any]) -> bool:
    """Whether a version is among those that an entry of OSV names.

    Args:
        version: Of the installed package.
        affected: One of the entry's "affected", with "versions" or "ranges" of events.
    """
    if version in affected.get("versions", []):
        return True
    ranges = [one["events"] for one in affected.get("ranges", []) if one.get("type") == "ECOSYSTEM"]
    return any(_in_range(Version(version), events) for events in ranges)


def _in_range(version: Version, events: list[dict[str, str]]) -> bool:
    """Whether the last event at or before the version leaves it affected."""
    inside = False
    for event in sorted(events, key=lambda one: _version(next(iter(one.values())))):
        ((kind, at),) = event.items()
        if kind == "introduced" and version >= _version(at):
            inside = True
        elif (kind == "fixed" and version >= _version(at)) or (kind == "last_affected" and version > _version(at)):
            inside = False
    return inside


def _version(text: str) -> Version:
    try:
        return Version(text)
    except InvalidVersion:
        return Version("0")


# ---------------------------------------------------------------- neither service nor copy


def _exempted(why: str, locks: Path, today: datetime.date) -> None:
    """Warn, if the repository says that these locks are used without an audit.

    Raises:
        InputError: It does not say so, or no longer.
    """
    advice = f"make a copy of {_COPY} where the network allows it, then: make OSV=all.zip dependencies"
    path = locks / EXEMPTION
    if not path.is_file():
        raise InputError(f"not audited: {why}, and there is no copy of its database; {advice}")
    try:
        said = tomllib.loads(path.read_text())
        reason, since, until, known = str(said["reason"]), said["since"], said["until"], dict(said["locks"])
        current = since <= today <= until
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise FileError(
            path, f"expected reason, since, until (dates) and locks with their SHA-256 ({error})"
        ) from error
    if not current:
        raise InputError(f"not audited: {why}, and {path.name} holds from {since} to {until}; {advice}")
    for lock in sorted(locks.glob("*.txt")):
        if known.get(lock.name) != hashlib.sha256(lock.read_bytes()).hexdigest():
            raise InputError(f"not audited: {why}, and {path.name} is of another {lock.name}; {advice}")
    Console().warn(f"NOT AUDITED: {why}. requirements/{path.name} allows it until {until}: {reason}")


if __name__ == "__main__":
    sys.exit(guarded(lambda: main(*sys.argv[1:2]), "dependencies"))
