"""From a recording of cameras to a dataset: detect, track, segment, together or one by one."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import ExitStack
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np

from pipelines.calling import jsonable
from pipelines.console import Console
from pipelines.datasets import Lineage, described, provenance
from pipelines.opening import CameraSource, Opened, open_recording, source_at
from pipelines.outputs import output_file
from pipelines.project import DATASETS, check_dataset_name, newest_recording
from pipelines.schemas import DetectConfig, IngestConfig, ObjectConfig, SegmentConfig, SegmentStageConfig, TrackConfig
from tossid.errors import ConfigError, FileError, InputError, ObjectError
from tossid.motion import covariance_source, median_rate, tosses_in_turn
from tossid.objects import ObjectModel
from tossid.store import dataset_writer, drawn_splits, source_sha256
from tossid.types import Detection, LongTrack, PoseTrack
from tossid.vision.believed import TrackSettings
from tossid.vision.camera import Camera
from tossid.vision.detect import DetectSettings, detect_frames
from tossid.vision.files import read_tracks
from tossid.vision.ground import find_ground
from tossid.vision.layout import articulated, object_body
from tossid.vision.segment import SegmentSettings, segment
from tossid.vision.spool import detections_aside, pose_spool
from tossid.vision.stream import settled, track_stream
from tossid.vision.track import Tracked

STAGES = Path("outputs/stages")
"""Where the stages leave their files, a folder for each recording."""
OFF = 0.01, np.deg2rad(1.0)
"""Height [m] and tilt [rad] from which on the world's z = 0 is not the ground that was meant."""


def ingest_frames(config: IngestConfig, source: CameraSource, console: Console) -> dict[str, Any]:
    """All three stages, from a recording to a dataset; no more than a stretch of it is in memory at a time."""
    opened = open_recording(source, config.object, default="cube")
    out = check_dataset_name("out", config.out or DATASETS / f"{opened.name}.h5")
    name = object_name(opened)
    with output_file(out) as temporary, pose_spool(temporary.parent) as spool:

        def keep(body: str, part: PoseTrack) -> None:
            if body == name:
                spool.add(part)

        tally: Counter[str] = Counter()
        detections = detected(opened, config.detect, threads=config.threads, console=console, tally=tally)
        aside = temporary.parent
        report = track_stage(opened, detections, config.track, console=console, aside=aside, keep=keep).report
        poses = spool.track()
        if poses is None:
            raise _too_few(opened, name)
        ground, rejected = _to_dataset(
            poses,
            opened,
            temporary,
            config,
            console,
            command="ingest",
            source=source.name,
            lineage={
                "source_path": str(opened.path),
                "source_sha256": source_sha256(opened.path),
                "n_images": opened.recording.n_frames if opened.recording is not None else 0,
                "n_detections": int(tally["tags"]),
                "n_poses": report.n_poses,
                "reprojection_rms_px": report.rms,
            },
        )
    facts = described(out, console)
    return {
        **facts, "detect": counts(tally), "track": asdict(report), "ground": ground, "segment": {"rejected": rejected}
    }  # fmt: skip


def open_stage(path: Path | None, config: ObjectConfig | None, *, default: str | None = None) -> Opened:
    """The recording that a stage's key names, whatever it holds; None for the newest in data/raw."""
    return open_recording(source_at(newest_recording() if path is None else path), config, default=default)


def detect_stage(
    opened: Opened, config: DetectConfig, *, threads: int | None, console: Console
) -> tuple[list[Detection], dict[str, int]]:
    """Tags in all frames, and what was rejected why; those that a bag has ready are taken as they are."""
    tally: Counter[str] = Counter()
    detections = list(detected(opened, config, threads=threads, console=console, tally=tally))
    return detections, counts(tally)


def detected(
    opened: Opened, config: DetectConfig, *, threads: int | None, console: Console, tally: Counter[str]
) -> Iterator[Detection]:
    """Tags as they are found. tally: filled with what was rejected why."""
    for problem in opened.problems:
        console.warn(problem)
    if opened.recording is None:
        console.say(f"{opened.path}: {len(opened.detections)} ready detections of {len(opened.cameras)} cameras")
        tally["tags"] += len(opened.detections)
        yield from opened.detections
        return
    n_frames = opened.recording.n_frames
    console.say(f"{opened.path}: {n_frames} images of {len(opened.cameras)} cameras")
    with console.progress("detect", n_frames, unit="images") as progress:
        yield from detect_frames(
            opened.recording,
            opened.model,
            settings=DetectSettings(**asdict(config)),
            threads=threads or os.cpu_count() or 1,
            tally=tally,
            progress=progress.advance,
        )
    if not tally["tags"]:
        raise InputError(f"{opened.path}: no tag was seen in {n_frames} images")
    console.say(f"detect: {tally['tags']} tags")


def counts(tally: Counter[str]) -> dict[str, int]:
    """A tally in order of its names."""
    return {name: int(count) for name, count in sorted(tally.items())}


def track_stage(
    opened: Opened,
    detections: Iterable[Detection],
    config: TrackConfig,
    *,
    console: Console,
    aside: Path | None = None,
    keep: Callable[[str, PoseTrack], None] | None = None,
) -> Tracked:
    """The poses of all moving bodies in every frame that shows them, and what else the scene did not say.

    Args:
        detections: as they come, in order of time; or all.
        aside: a folder where those that come lie on the disk while they are needed more than once.
        keep: takes the poses instead, as `track_stream` has it.
    """
    settings = TrackSettings(**asdict(config))
    if opened.model is None:  # of bodies that nothing is known of, no accuracy is asked
        settings = replace(settings, max_sigma=float("inf"), max_angle_sigma=float("inf"))
    layout = opened.layout if opened.model is None else articulated(opened.layout, opened.model)
    with ExitStack() as stack:
        if isinstance(detections, Sequence):
            detections = sorted(detections, key=lambda detection: detection.t)
        elif aside is not None and not settled(opened.cameras, layout):
            detections = stack.enter_context(detections_aside(detections, aside))
        bar = None
        if not isinstance(detections, Iterator):  # those that are still to be found have their own
            bar = stack.enter_context(console.progress("track", None, unit="poses")).advance
        tracked = track_stream(
            detections, opened.cameras, layout, settings=settings, name=opened.name, progress=bar, keep=keep
        )
    report = tracked.report
    console.say(f"track: {report.n_poses} poses in {report.n_steps} frames, reprojection {report.rms:.2f} px rms")
    for reason, count in report.dropped_steps.items():
        console.say(f"  {count} frames without a pose: {reason}")
    for suspect in report.suspects:
        console.warn(suspect.message)
    for camera, (offset, sigma) in report.clocks.items():
        console.warn(f"camera {camera}'s clock is {offset * 1e3:.2f} ms late (± {sigma * 1e3:.2f}); that is taken off")
    for name in report.unplaced:
        console.warn(f"{name} was never seen together with anything of known pose")
    return tracked


def with_clocks(tracked: Tracked) -> tuple[Camera, ...]:
    """The cameras that tracking found, their clocks' offsets with them."""
    clocks = tracked.report.clocks
    return tuple(
        replace(camera, clock_offset=camera.clock_offset + clocks.get(camera.name, (0.0, 0.0))[0])
        for camera in tracked.cameras
    )


def object_name(opened: Opened) -> str:
    """The name of the object's body in the scene.

    Raises:
        ObjectError: the object is no moving body of the scene.
    """
    model = opened.object()
    body = object_body(opened.layout, model.body_names)
    if body is None or body.is_static:
        names = ", ".join(body.name for body in opened.layout.bodies)
        raise ObjectError(f"object '{model.name}' is no moving body of the scene (its bodies: {names})")
    return body.name


def object_track(opened: Opened, tracked: Tracked) -> PoseTrack:
    """The track of the object's body, with its joints.

    Raises:
        ObjectError: the object is no moving body of the scene.
        InputError: it has too few poses.
    """
    name = object_name(opened)
    if name not in tracked.tracks:
        raise _too_few(opened, name)
    return tracked.tracks[name]


def _too_few(opened: Opened, body: str) -> InputError:
    return InputError(f"{opened.path}: too few poses of '{body}' for a track")


def level_stage(
    opened: Opened, poses: PoseTrack | LongTrack, level: str, *, gravity: float, console: Console
) -> tuple[PoseTrack | LongTrack, dict[str, Any] | None]:
    """Poses in the ground's frame, where the set-up does not give it (the key `level`), and what was found of it."""
    try:
        ground = find_ground(poses, opened.object(), gravity=gravity)
    except InputError as error:
        console.say(f"ground: as the set-up has it ({error})")
        return poses, None
    tilt, slope = np.rad2deg(ground.tilt), np.rad2deg(float(np.linalg.norm(ground.slope)))
    sigma = 1e3 * float(np.sqrt(ground.cov[0, 0]))
    off = bool(abs(ground.height) > OFF[0] or ground.tilt > OFF[1])
    told = any(body.is_static and body.tags for body in opened.layout.bodies)
    do = level == "always" or (level == "auto" and off and not told)
    console.say(
        f"ground: {1e3 * ground.height:.2f} mm high (± {sigma:.2f}), up is {tilt:.2f}° from z, it slopes by "
        f"{slope:.2f}°; from {ground.n_rests} rests and {ground.n_falling} frames of flight"
    )
    if do:
        console.warn("the world is turned and shifted so that the ground is z = 0 (level=never leaves it)")
    elif off:
        console.warn("the world's z = 0 is not the ground; level=always turns and shifts it")
    facts = {**jsonable(asdict(ground)), "levelled": do}
    if not do:
        return poses, facts
    return LongTrack(poses.name, poses.t, lambda which: ground.levelled(poses.frames(which))), facts


def segment_stage(
    poses: PoseTrack | LongTrack, model: ObjectModel, config: SegmentConfig, *, gravity: float, console: Console
) -> tuple[Sequence[PoseTrack], list[dict[str, Any]]]:
    """The tosses' tracks, and the stretches that are no toss."""
    tracks, stretches = segment(poses, model, gravity=gravity, settings=SegmentSettings(**asdict(config)))
    console.say(f"segment: {len(tracks)} tosses; {len(stretches)} stretches are none")
    for stretch in stretches:
        console.say(f"  {stretch.t0:.2f} s to {stretch.t1:.2f} s: {stretch.reason}")
    if not tracks:
        raise InputError(f"no toss in {len(poses.t)} poses of '{model.name}'; see the reasons above")
    return tracks, [{"t0": s.t0, "t1": s.t1, "reason": s.reason} for s in stretches]


def segment_file(config: SegmentStageConfig, console: Console) -> dict[str, Any]:
    """The third stage from file to file."""
    opened = open_stage(config.recording, config.object, default="cube")
    source = config.poses or STAGES / opened.name / "poses.npz"
    out = check_dataset_name("out", config.out or DATASETS / f"{opened.name}.h5")
    poses = read_track(source)
    with output_file(out) as temporary:
        lineage = {"source_path": str(source), "source_sha256": source_sha256(source)}
        ground, rejected = _to_dataset(
            poses, opened, temporary, config, console, command="segment", source="frames", lineage=lineage
        )
    return {**described(out, console), "ground": ground, "segment": {"rejected": rejected}}


def _to_dataset(
    poses: PoseTrack | LongTrack,
    opened: Opened,
    path: Path,
    config: IngestConfig | SegmentStageConfig,
    console: Console,
    *,
    command: str,
    source: str,
    lineage: Lineage,
) -> tuple[dict[str, Any] | None, list[dict[str, Any]]]:
    """Level, segment, smooth and write, toss by toss; returns what was found of the ground, and what is no toss."""
    model, gravity = opened.object(), config.gravity
    poses, ground = level_stage(opened, poses, config.level, gravity=gravity, console=console)
    tracks, rejected = segment_stage(poses, model, config.segment, gravity=gravity, console=console)
    with dataset_writer(model, path) as writer:
        for toss in tosses_in_turn(tracks, model, gravity=gravity):
            writer.add(toss)
        writer.finish(
            rate_hz=median_rate(tracks),
            source=source,
            provenance=provenance(command, config, {**lineage, "covariance_source": covariance_source(tracks)}),
            splits=drawn_splits([track.name for track in tracks], fractions=config.splits, seed=config.seed),
        )
    return ground, rejected


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
