"""`tossid ingest`: raw recordings, tracked poses or published tosses to a dataset."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import yaml

from pipelines.cli.console import Console, reported
from pipelines.commands.info import show
from pipelines.config.compose import as_plain
from pipelines.config.schemas import IngestConfig
from pipelines.execution.code_version import commit, version
from pipelines.files.project import DATASET_SUFFIXES, DATASETS, named
from tossid.versions import computing_versions

if TYPE_CHECKING:
    from tossid.ingestion.ingest import IngestReport

_NOT_LINEAGE = ("out", "threads")
"""Keys that leave the data as they are: the same data from the same call are the same bytes."""


def run(config: IngestConfig, console: Console) -> dict[str, Any]:
    """Read the source, write the dataset; returns what `info` says of it, `out`, and what became of the source."""
    from pipelines.files.open_source import located
    from tossid.ingestion.ingest import ingest_source
    from tossid.vision.recordings.registry import recording_name

    source = located(config.source)
    out = named("out", config.out or DATASETS / f"{recording_name(source.path)}.h5", *DATASET_SUFFIXES)
    lineage = provenance("ingest", config, {})
    with reported(console) as progress:
        report = ingest_source(
            source, object=config.object, settings=config, out=out, progress=progress, provenance=lineage
        ).report
    return {**described(out, console), **facts(report)}


def provenance(command: str, config: Any, lineage: Mapping[str, str]) -> dict[str, str | int | float | bool]:
    """Where a dataset comes from.

    Args:
        command: The command that made it.
        config: All its keys.
        lineage: Source path and hash, covariances' origin, and the like.

    Returns:
        Values by name.
    """
    keys = {name: value for name, value in as_plain(config).items() if name not in _NOT_LINEAGE}
    return {
        "command": f"tossid {command}",
        "version": version(),
        "commit": commit(),
        "versions": json.dumps(computing_versions()),
        "config": yaml.safe_dump(keys, sort_keys=False, allow_unicode=True),
        **lineage,
    }


def described(path: Path, console: Console) -> dict[str, Any]:
    """What `tossid info` says of a dataset that was just written, and `out`."""
    from tossid.store import dataset_info

    found = {**dataset_info(path), "out": str(path)}
    show({name: value for name, value in found.items() if name != "provenance"}, console, title=f"wrote {path}")
    return found


def facts(report: IngestReport) -> dict[str, Any]:
    """What became of the source, by the names of the stages that it went through."""
    found: dict[str, Any] = {"defects": [asdict(defect) for defect in report.defects]} if report.defects else {}
    if report.track is not None:
        found |= {"detect": dict(report.detect), "track": asdict(report.track)}
    if report.rejected is not None:
        rejected = [{"t0": each.t0, "t1": each.t1, "reason": each.reason} for each in report.rejected]
        ground = None if report.ground is None else report.ground.as_dict()
        found |= {"ground": ground, "segment": {"rejected": rejected}}
    return found
