"""`tossid detect`: tags in a recording's frames, to a file."""

from __future__ import annotations

from typing import Any

from pipelines.console import Console
from pipelines.frames import STAGES, check_stage_name, detect_stage, open_stage
from pipelines.outputs import output_file
from pipelines.schemas import DetectStageConfig
from tossid.vision.files import write_detections


def run(config: DetectStageConfig, console: Console) -> dict[str, Any]:
    """Detect, write; returns counts and `out`."""
    opened = open_stage(config.recording, config.object)
    n_images = opened.images().n_frames
    out = check_stage_name("out", config.out or STAGES / opened.name / "detections.npz")
    with output_file(out) as temporary:
        detections, tally = detect_stage(opened, config.detect, threads=config.threads, console=console)
        write_detections(detections, temporary)
    console.facts(tally, title=f"wrote {out}")
    return {
        "out": str(out),
        "recording": str(opened.path),
        "object": opened.model.name if opened.model is not None else None,
        "n_images": n_images,
        "n_detections": len(detections),
        "counts": tally,
    }
