"""`tossid segment`: tosses from tracked poses, to a dataset."""

from __future__ import annotations

from typing import Any

from pipelines.cli.console import Console, reported
from pipelines.commands.ingest import described, facts, provenance
from pipelines.config.schemas import SegmentStageConfig
from pipelines.files.open_source import POSES, open_stage, stage_file, stage_tracks
from pipelines.files.project import DATASET_SUFFIXES, DATASETS, named
from tossid.errors import FileError
from tossid.ingestion.ingest import dataset_of_poses
from tossid.ingestion.progress import Reporter
from tossid.store import source_sha256


def run(config: SegmentStageConfig, console: Console) -> dict[str, Any]:
    """Segment, write; returns what `info` says of the dataset, `out`, the ground, and what is no toss."""
    opened = open_stage(config.recording, config.object, default="cube")
    source = config.poses or stage_file(opened, POSES)
    out = named("out", config.out or DATASETS / f"{opened.name}.h5", *DATASET_SUFFIXES)
    tracks = stage_tracks(opened, source)
    if len(tracks) != 1:
        raise FileError(source, f"holds {len(tracks)} tracks, expected one")
    lineage = provenance("segment", config, {"source_path": str(source), "source_sha256": source_sha256(source)})
    with reported(console) as progress:
        report = dataset_of_poses(
            opened, tracks[0], settings=config, out=out, lineage=lineage, report=Reporter(progress)
        ).report
    return {**described(out, console), **facts(report)}
