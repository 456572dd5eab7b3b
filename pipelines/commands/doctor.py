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
    findings = [*_packages(), *_machine(), *_store(), *_data()]
    marks = {"good": "good", "optional": "-", "missing": "MISSING"}
    console.say(version_line())
    console.table(["", "what", "found", "what to do"], [[marks[f.state], f.what, f.found, f.advice] for f in findings])
    missing = [finding.what for finding in findings if finding.state == "missing"]
    console.say(f"missing: {', '.join(missing)}" if missing else "nothing that is needed is missing")
    return {"ok": not missing, "version": version_line(), "findings": [asdict(finding) for finding in findings]}


def _finding(what: str, good: str, *, problem: str, advice: str, else_state: State = "missing") -> Finding:
    """What was found, with what to do where there is a problem."""
    return Finding(what, else_state, problem, advice) if problem else Finding(what, "good", good)


def _requirements() -> dict[str, list[str]]:
    """What the installed tossid needs, under "", and what each of its extras needs."""
    from packaging.requirements import Requirement

    found: dict[str, list[str]] = {
        name: [] for name in ("", *(metadata.metadata("tossid").get_all("Provides-Extra") or ()))
    }
    for each in map(Requirement, metadata.requires("tossid") or ()):
        always = each.marker is None or each.marker.evaluate({"extra": ""})
        names = [""] if always else [name for name in found if each.marker and each.marker.evaluate({"extra": name})]
        for name in names:
            found[name].append(f"{each.name}{each.specifier}")
    return found


def _lacking(requirements: list[str]) -> str:
    """Of requirements, those that are not met: "name 1.2 (needs ~=1.3)"."""
    from packaging.requirements import Requirement

    lacking = []
    for each in map(Requirement, requirements):
        try:
            found = metadata.version(each.name)
        except metadata.PackageNotFoundError:
            lacking.append(f"{each.name} (needs {each.specifier})")
            continue
        if not each.specifier.contains(found, prereleases=True):
            lacking.append(f"{each.name} {found} (needs {each.specifier})")
    return ", ".join(lacking)


def _packages() -> Iterator[Finding]:
    for name, requirements in _requirements().items():
        lacking, purpose = _lacking(requirements), _PURPOSE.get(name, name)
        if not name:
            advice, count = "make setup, or pip install -e .", f"{len(requirements)} of {len(requirements)}"
            yield _finding("packages", count, problem=lacking, advice=advice)
            continue
        advice = f"for {purpose}: pip install -e '.[{name}]'"
        problem = lacking and f"without {lacking}"
        yield _finding(f"extra {name}", purpose, problem=problem, advice=advice, else_state="optional")


def _machine() -> Iterator[Finding]:
    yield Finding("Python", "good", f"{platform.python_version()} ({sys.executable})")
    cores = os.cpu_count() or 1
    memory = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") / 2**30
    yield Finding("machine", "good", f"{cores} cores, {memory:.0f} GiB of memory, {platform.platform(terse=True)}")
    free = shutil.disk_usage(".").free / 1e9
    here = Path.cwd()
    if os.access(here, os.W_OK):
        problem = f"{here}: {free:.1f} GB free" if free < _LEAST_SPACE else ""
        advice = "make room: recordings and runs grow"
    else:
        problem, advice = f"{here} cannot be written to", "work in a folder of your own"
    yield _finding("this folder", f"{here}: {free:.0f} GB free", problem=problem, advice=advice)


def _store() -> Iterator[Finding]:
    """Where runs are tracked, and whether it answers."""
    from pipelines.tracking.addresses import is_database, is_server, without_password

    uri = os.environ.get("MLFLOW_TRACKING_URI", "")
    named = without_password(uri)
    if is_server(uri) or is_database(uri):
        from pipelines.tracking.mlflow_store import client

        problem = ""
        try:
            client()
        except InputError as error:
            problem = str(error)
        advice = "docs/guide/server.md has how to start a server"
        yield _finding("MLflow", f"{named} answers", problem=problem, advice=advice)
        return
    there = named or ("mlflow.db" if Path("mlflow.db").exists() else "mlflow.db, made by the first run")
    yield Finding("MLflow", "good", there)


def _data() -> Iterator[Finding]:
    recordings = sorted(path.parent.name for path in RECORDINGS.glob("*/cameras.yaml"))
    datasets = sorted(path.name for path in DATASETS.glob("*.h5"))
    to_record = "work in tossid's folder, which ships one, or make one: tossid synthesize"
    for what, found, folder, advice in (
        ("recordings", recordings, RECORDINGS, to_record),
        ("datasets", datasets, DATASETS, "make one: tossid ingest"),
    ):
        problem = "" if found else f"none in {folder}"
        yield _finding(what, f"{len(found)} in {folder}", problem=problem, advice=advice, else_state="optional")
