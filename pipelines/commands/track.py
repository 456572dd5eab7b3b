"""`tossid track`: poses from detected tags, from file to file."""

from __future__ import annotations

from contextlib import ExitStack
from dataclasses import asdict
from pathlib import Path
from typing import Any

from pipelines.cli.console import Console, reported
from pipelines.config.schemas import TrackStageConfig
from pipelines.files.open_source import POSES, open_stage, stage_detections, stage_file
from pipelines.files.project import named
from tossid.ingestion import stages
from tossid.ingestion.progress import Reporter
from tossid.outputs import output_file, output_folder
from tossid.store.importers.tum import write_trajectory
from tossid.types import PoseTrack
from tossid.vision.recordings.npz import write_tracks
from tossid.vision.setup.calibration import write_cameras
from tossid.vision.setup.tagslam import write_tagslam


def run(config: TrackStageConfig, console: Console) -> dict[str, Any]:
    """Track, write; returns the report and `out`."""
    opened = open_stage(config.recording, config.object)
    for problem in opened.problems:
        console.warn(problem)
    detections = stage_detections(opened, config.detections)
    out = named("out", config.out or stage_file(opened, POSES), ".npz")
    with reported(console) as progress:
        tracked = stages.track(opened, detections, settings=config.track, report=Reporter(progress))
    tracks = list(tracked.tracks.values()) if opened.model is None else [stages.object_track(opened, tracked)]
    texts = [_text_path(out, track, len(tracks)) for track in tracks]
    set_up = out.parent / f"{out.stem}_set_up"
    with ExitStack() as stack:
        write_tracks(tracks, stack.enter_context(output_file(out)))
        for track, text in zip(tracks, texts, strict=True):
            write_trajectory(stack.enter_context(output_file(text)), track)
        folder = stack.enter_context(output_folder(set_up, made_by="track"))
        write_cameras(stages.corrected_cameras(tracked), folder)
        write_tagslam(tracked.layout, folder / "tagslam.yaml")
    console.say(f"wrote {', '.join(map(str, (out, *texts, set_up)))}")
    return {
        "out": str(out),
        "tum": str(texts[0]) if len(texts) == 1 else [str(text) for text in texts],
        "set_up": str(set_up),
        "recording": str(opened.path),
        "problems": list(opened.problems),
        "bodies": {name: len(track.t) for name, track in tracked.tracks.items()},
        **asdict(tracked.report),
    }


def _text_path(out: Path, track: PoseTrack, count: int) -> Path:
    return out.with_suffix(".txt") if count == 1 else out.with_name(f"{out.stem}_{track.name}.txt")
