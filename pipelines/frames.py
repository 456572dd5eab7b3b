"""From a recording of camera frames to a dataset: detect, track, segment, together or one by one."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

from pipelines.console import Console
from pipelines.datasets import described, save
from pipelines.outputs import output_file, recover_folder
from pipelines.project import (
    DATASETS,
    check_dataset_name,
    load_object,
    newest_recording,
    object_named,
    recorded_object,
)
from pipelines.schemas import (
    DetectConfig,
    FramesSource,
    IngestConfig,
    ObjectConfig,
    SegmentConfig,
    SegmentStageConfig,
    TrackConfig,
)
from tossid.errors import ConfigError, FileError, InputError
from tossid.motion import covariance_source, median_rate, tosses_from_tracks
from tossid.objects import ObjectModel
from tossid.store import draw_splits, source_sha256
from tossid.types import Detection, PoseTrack, Toss
from tossid.vision.detect import DetectSettings, detect_frames
from tossid.vision.files import read_tracks
from tossid.vision.recording import Recording, read_recording
from tossid.vision.segment import SegmentSettings, segment
from tossid.vision.layout import object_tags
from tossid.vision.track import TrackReport, TrackSettings, track

STAGES = Path("outputs/stages")
"""Where the stages leave their files, a folder for each recording."""


@dataclass(frozen=True)
class Opened:
    """A recording, and the object in it with the tags that the recording says it has."""

    path: Path
    recording: Recording
    model: ObjectModel

    @property
    def name(self) -> str:
        return self.path.resolve().name


def ingest_frames(config: IngestConfig, source: FramesSource, console: Console) -> dict[str, Any]:
    """All three stages in memory, from a recording to a dataset."""
    opened = open_recording(source.path, config.object)
    out = check_dataset_name("out", config.out or DATASETS / f"{opened.name}.h5")
    with output_file(out) as temporary:
        detections, tally = detect_stage(opened, config.detect, threads=config.threads, console=console)
        poses, report = track_stage(opened, detections, config.track, console=console)
        tosses, tracks, rejected = segment_stage(
            poses, opened.model, config.segment, gravity=config.gravity, console=console
        )
        _save(
            tosses,
            tracks,
            opened.model,
            temporary,
            config,
            command="ingest",
            source_path=str(opened.path),
            source_sha256=source_sha256(opened.path),
            n_images=opened.recording.n_frames,
            n_detections=len(detections),
            n_poses=report.n_poses,
            reprojection_rms_px=report.rms,
        )
    facts = described(out, console)
    return {**facts, "detect": tally, "track": asdict(report), "segment": {"rejected": rejected}}


def open_recording(path: Path | None, config: ObjectConfig | None) -> Opened:
    """The recording that a key names, with its object.

    Args:
        path: None for the newest in data/raw.
        config: None for the object that the recording names, else the cube.
    """
    if path is not None:
        recover_folder(path)
    path = newest_recording() if path is None else path
    recording = read_recording(path)
    model = load_object(replace(config or recorded_object(path) or object_named("cube"), tags=None))
    return Opened(path, recording, replace(model, tags=object_tags(recording.layout, model.body_names)))


def detect_stage(
    opened: Opened, config: DetectConfig, *, threads: int | None, console: Console
) -> tuple[list[Detection], dict[str, int]]:
    """Tags in all frames, and what was rejected why."""
    tally: Counter[str] = Counter()
    n_frames = opened.recording.n_frames
    console.say(f"{opened.path}: {n_frames} images of {len(opened.recording.cameras)} cameras")
    with console.progress("detect", n_frames, unit="images") as progress:
        detections = list(
            detect_frames(
                opened.recording,
                opened.model,
                settings=DetectSettings(**asdict(config)),
                threads=threads or os.cpu_count() or 1,
                tally=tally,
                progress=progress.advance,
            )
        )
    if not detections:
        raise InputError(f"{opened.path}: no tag of '{opened.model.name}' was seen in {n_frames} images")
    console.say(f"detect: {len(detections)} tags")
    return detections, {name: int(count) for name, count in sorted(tally.items())}


def track_stage(
    opened: Opened, detections: Sequence[Detection], config: TrackConfig, *, console: Console
) -> tuple[PoseTrack, TrackReport]:
    """The object's pose in every frame that shows it."""
    with console.progress("track", None, unit="poses") as progress:
        poses, report = track(
            detections,
            opened.recording.cameras,
            opened.model,
            settings=TrackSettings(**asdict(config)),
            name=opened.name,
        )
        progress.advance(report.n_poses)
    console.say(f"track: {report.n_poses} poses in {report.n_steps} frames, reprojection {report.rms:.2f} px rms")
    for reason, count in report.dropped_steps.items():
        console.say(f"  {count} frames without a pose: {reason}")
    return poses, report


def segment_stage(
    poses: PoseTrack, model: ObjectModel, config: SegmentConfig, *, gravity: float, console: Console
) -> tuple[tuple[Toss, ...], tuple[PoseTrack, ...], list[dict[str, Any]]]:
    """Tosses with velocities, the tracks they were made of, and the stretches that are no toss."""
    tracks, stretches = segment(poses, model, gravity=gravity, settings=SegmentSettings(**asdict(config)))
    console.say(f"segment: {len(tracks)} tosses; {len(stretches)} stretches are none")
    for stretch in stretches:
        console.say(f"  {stretch.t0:.2f} s to {stretch.t1:.2f} s: {stretch.reason}")
    if not tracks:
        raise InputError(f"no toss in {len(poses.t)} poses of '{model.name}'; see the reasons above")
    tosses = tosses_from_tracks(tracks, model, gravity=gravity)
    return tosses, tracks, [{"t0": s.t0, "t1": s.t1, "reason": s.reason} for s in stretches]


def segment_file(config: SegmentStageConfig, console: Console) -> dict[str, Any]:
    """The third stage from file to file."""
    opened = open_recording(config.recording, config.object)
    source = config.poses or STAGES / opened.name / "poses.npz"
    out = check_dataset_name("out", config.out or DATASETS / f"{opened.name}.h5")
    poses = read_track(source)
    with output_file(out) as temporary:
        tosses, tracks, rejected = segment_stage(
            poses, opened.model, config.segment, gravity=config.gravity, console=console
        )
        _save(
            tosses,
            tracks,
            opened.model,
            temporary,
            config,
            command="segment",
            source_path=str(source),
            source_sha256=source_sha256(source),
        )
    return {**described(out, console), "segment": {"rejected": rejected}}


def _save(
    tosses: Sequence[Toss],
    tracks: Sequence[PoseTrack],
    model: ObjectModel,
    path: Path,
    config: IngestConfig | SegmentStageConfig,
    *,
    command: str,
    **lineage: str | int | float,
) -> None:
    """Draw the splits and write what camera frames gave, with its lineage."""
    save(
        draw_splits(tosses, fractions=config.splits, seed=config.seed),
        model,
        path,
        rate_hz=median_rate(tracks),
        source="frames",
        command=command,
        config=config,
        lineage={**lineage, "covariance_source": covariance_source(tracks)},
    )


def read_track(path: Path) -> PoseTrack:
    """The one track that `tossid track` wrote."""
    if not path.is_file():
        raise FileError(path, "no such file; 'tossid track' makes it")
    tracks = read_tracks(path)
    if len(tracks) != 1:
        raise FileError(path, f"holds {len(tracks)} tracks, expected one")
    return tracks[0]


def check_stage_name(key: str, path: Path) -> Path:
    """Stages leave files named *.npz."""
    if path.suffix != ".npz":
        raise ConfigError(key, f"'{path}' does not end in .npz.", suggestion=str(path.with_suffix(".npz")))
    return path
