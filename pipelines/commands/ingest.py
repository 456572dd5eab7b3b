"""`tossid ingest`: raw recordings, tracked poses or published tosses to a dataset."""

from __future__ import annotations

from dataclasses import asdict
from typing import TYPE_CHECKING, Any

from pipelines.cli.console import Console
from pipelines.cli.progress import reported
from pipelines.config.schemas import IngestConfig
from pipelines.files.project import DATASET_SUFFIXES, DATASETS, named

if TYPE_CHECKING:
    from tossid.ingestion.ingest import IngestReport
    from tossid.motion.segmentation import Stretch


def run(config: IngestConfig, console: Console) -> dict[str, Any]:
    """Read the source, write the dataset; returns what `info` says of it, `out`, and what became of the source."""
    from pipelines.files.datasets import described, provenance
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


def facts(report: IngestReport) -> dict[str, Any]:
    """What became of the source, by the names of the stages that it went through."""
    found: dict[str, Any] = {"defects": [asdict(defect) for defect in report.defects]} if report.defects else {}
    if report.track is not None:
        found |= {"detect": dict(report.detect), "track": asdict(report.track)}
    if report.rejected is not None:
        ground = None if report.ground is None else report.ground.as_dict()
        found |= {"ground": ground, "segment": {"rejected": [_short(stretch) for stretch in report.rejected]}}
    return found


def _short(stretch: Stretch) -> dict[str, Any]:
    return {"t0": stretch.t0, "t1": stretch.t1, "reason": stretch.reason}
