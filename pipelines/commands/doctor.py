"""`tossid doctor`: what is installed, what is missing, and what to do about it."""

from __future__ import annotations

import os
import platform
import shutil
import sys
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from importlib import metadata
from pathlib import Path
from typing import Any, Literal

from pipelines.cli.console import Console
from pipelines.execution.code_version import version_line
from pipelines.files.project import DATASETS, RECORDINGS
from tossid.errors import InputError

State = Literal["good", "optional", "missing"]
_PURPOSE = {
    "cluster": "studies and audits on a cluster (launcher=dask, launcher=slurm)",
    "server": "a tracking server on PostgreSQL",
    "view": "tossid view in 3D",
    "docs": "the documentation as a site",
    "dev": "tests and checks",
}
_LEAST_SPACE = 2.0
"""Free space below which a warning is due [GB]."""


@dataclass(frozen=True)
class Finding:
    """state: good; optional (absent, and only some commands need it); missing. advice: what to do, "" for nothing."""

    what: str
    state: State
    found: str
    advice: str = ""


def run(_: None, console: Console) -> dict[str, Any]:
    """Look; returns all findings, and whether nothing that is needed is missing."""
    findings = [*_python(), *_packages(), *_extras(), *_machine(), *_store(), *_data()]
    marks = {"good": "good", "optional": "-", "missing": "MISSING"}
    console.say(version_line())
    console.table(["", "what", "found", "what to do"], [[marks[f.state], f.what, f.found, f.advice] for f in findings])
    missing = [finding.what for finding in findings if finding.state == "missing"]
    console.say(f"missing: {', '.join(missing)}" if missing else "nothing that is needed is missing")
    return {"ok": not missing, "version": version_line(), "findings": [asdict(finding) for finding in findings]}


def _python() -> Iterator[Finding]:
    found = f"{platform.python_version()} ({sys.executable})"
    fits = sys.version_info >= (3, 11)
    yield Finding("Python", "good" if fits else "missing", found, "" if fits else "Python 3.11 or newer")


def _declared() -> tuple[list[str], dict[str, list[str]]]:
    """What the installed tossid needs, and what each of its extras needs."""
    from packaging.requirements import Requirement

    needed: list[str] = []
    extras: dict[str, list[str]] = {name: [] for name in metadata.metadata("tossid").get_all("Provides-Extra") or ()}
    for text in metadata.requires("tossid") or ():
        requirement = Requirement(text)
        plain = f"{requirement.name}{requirement.specifier}"
        own = [name for name in extras if requirement.marker and requirement.marker.evaluate({"extra": name})]
        if requirement.marker is None or requirement.marker.evaluate({"extra": ""}):
            needed.append(plain)
        for name in own:
            extras[name].append(plain)
    return needed, extras


def _lacking(requirements: list[str]) -> list[str]:
    """Of requirements, those that are not met: "name 1.2 (needs ~=1.3)"."""
    from packaging.requirements import Requirement

    lacking = []
    for text in requirements:
        requirement = Requirement(text)
        if requirement.name == "tossid":
            continue
        try:
            found = metadata.version(requirement.name)
        except metadata.PackageNotFoundError:
            lacking.append(f"{requirement.name} (needs {requirement.specifier})")
            continue
        if not requirement.specifier.contains(found, prereleases=True):
            lacking.append(f"{requirement.name} {found} (needs {requirement.specifier})")
    return lacking


def _packages() -> Iterator[Finding]:
    needed, _ = _declared()
    lacking = _lacking(needed)
    if lacking:
        yield Finding("packages", "missing", ", ".join(lacking), "make setup, or pip install -e .")
    else:
        yield Finding("packages", "good", f"{len(needed)} of {len(needed)}")


def _extras() -> Iterator[Finding]:
    for name, requirements in _declared()[1].items():
        lacking, purpose = _lacking(requirements), _PURPOSE.get(name, name)
        if lacking:
            advice = f"for {purpose}: pip install -e '.[{name}]'"
            yield Finding(f"extra {name}", "optional", f"without {', '.join(lacking)}", advice)
        else:
            yield Finding(f"extra {name}", "good", purpose)


def _machine() -> Iterator[Finding]:
    cores = os.cpu_count() or 1
    memory = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") / 2**30
    yield Finding("machine", "good", f"{cores} cores, {memory:.0f} GiB of memory, {platform.platform(terse=True)}")
    free = shutil.disk_usage(".").free / 1e9
    here = Path.cwd()
    if not os.access(here, os.W_OK):
        yield Finding("this folder", "missing", f"{here} cannot be written to", "work in a folder of your own")
    elif free < _LEAST_SPACE:
        yield Finding("this folder", "missing", f"{here}: {free:.1f} GB free", "make room: recordings and runs grow")
    else:
        yield Finding("this folder", "good", f"{here}: {free:.0f} GB free")


def _store() -> Iterator[Finding]:
    """Where runs are tracked, and whether it answers."""
    from pipelines.tracking.addresses import is_database, is_server, without_password

    uri = os.environ.get("MLFLOW_TRACKING_URI", "")
    named = without_password(uri)
    if is_server(uri) or is_database(uri):
        from pipelines.tracking.mlflow_store import client

        try:
            client()
        except InputError as error:
            yield Finding("MLflow", "missing", str(error), "docs/guide/server.md has how to start a server")
        else:
            yield Finding("MLflow", "good", f"{named} answers")
        return
    there = named or ("mlflow.db" if Path("mlflow.db").exists() else "mlflow.db, made by the first run")
    yield Finding("MLflow", "good", there)


def _data() -> Iterator[Finding]:
    recordings = sorted(path.parent.name for path in RECORDINGS.glob("*/cameras.yaml"))
    datasets = sorted(path.name for path in DATASETS.glob("*.h5"))
    if recordings:
        yield Finding("recordings", "good", f"{len(recordings)} in {RECORDINGS}")
    else:
        advice = "work in tossid's folder, which ships one, or make one: tossid synthesize"
        yield Finding("recordings", "optional", f"none in {RECORDINGS}", advice)
    if datasets:
        yield Finding("datasets", "good", f"{len(datasets)} in {DATASETS}")
    else:
        yield Finding("datasets", "optional", f"none in {DATASETS}", "make one: tossid ingest")
