"""`tossid track`: poses from detected tags, from file to file."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import asdict
from pathlib import Path
from typing import Any

from pipelines.cli.console import Console
from pipelines.cli.progress import reported
from pipelines.config.schemas import TrackStageConfig
from pipelines.files.open_source import STAGES, open_stage
from pipelines.files.project import named
from tossid.errors import FileError
from tossid.ingestion import stages
from tossid.ingestion.progress import Reporter
from tossid.outputs import output_file, output_folder
from tossid.store.importers.tum import write_trajectory
from tossid.types import Detection, PoseTrack
from tossid.vision.recordings.npz import read_detections, write_tracks
from tossid.vision.recordings.registry import Opened
from tossid.vision.setup.calibration import write_cameras
from tossid.vision.setup.tagslam import write_tagslam


def run(config: TrackStageConfig, console: Console) -> dict[str, Any]:
    """Track, write; returns the report and `out`."""
    opened = open_stage(config.recording, config.object)
    for problem in opened.problems:
        console.warn(problem)
    detections = _detections(config, opened)
    out = named("out", config.out or STAGES / opened.name / "poses.npz", ".npz")
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


def _detections(config: TrackStageConfig, opened: Opened) -> Sequence[Detection]:
    if config.detections is None and opened.recording is None:
        return opened.detections
    source = config.detections or STAGES / opened.name / "detections.npz"
    if not source.is_file():
        raise FileError(source, "no such file; 'tossid detect' makes it")
    return read_detections(source)


def _text_path(out: Path, track: PoseTrack, count: int) -> Path:
    return out.with_suffix(".txt") if count == 1 else out.with_name(f"{out.stem}_{track.name}.txt")
