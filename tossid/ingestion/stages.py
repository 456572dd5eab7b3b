"""The stages from a recording to the tracks of its tosses: detect, track, level, segment."""

from __future__ import annotations

import math
import os
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from tossid.errors import InputError, ObjectError
from tossid.ingestion.progress import Reporter
from tossid.motion.ground_plane import Ground, find_ground
from tossid.motion.segmentation import Stretch, segment
from tossid.motion.sessions import find_sessions, levelled_tracks, session_words
from tossid.motion.sessions.search import recording_order
from tossid.motion.sessions.turns import Turns, find_turns
from tossid.motion.sessions.witnesses import fall_words
from tossid.objects import ObjectModel
from tossid.settings.ingestion import DetectSettings, IngestSettings, TossSettings
from tossid.settings.tracking import TrackSettings
from tossid.types import Detection, LongTrack, OnDemand, PoseTrack, RecordingOrder
from tossid.vision.cameras.camera import Camera
from tossid.vision.detection.detect import DAMAGED, detect_frames
from tossid.vision.detection.second_look import usual_cause
from tossid.vision.pose_graph.scene import words
from tossid.vision.pose_graph.stream import needs_all, track_stream
from tossid.vision.pose_graph.track import Tracked
from tossid.vision.recordings.registry import Opened
from tossid.vision.setup.layout import articulated, object_body

LEVEL_HEIGHT, LEVEL_TILT = 0.01, math.radians(1.0)
"""Height above z = 0 [m], and tilt [rad], of the ground from which on `level=auto` levels the world."""
DETECT, TRACK, SEGMENT = DetectSettings(), TrackSettings(), TossSettings()


@dataclass(frozen=True, eq=False)
class Levelled:
    """The ground that was found from a track, and whether the track was turned and shifted to it."""

    ground: Ground
    """the ground in the world's frame"""
    levelled: bool
    """whether the world was turned and shifted so that the ground is z = 0"""

    def as_dict(self) -> dict[str, Any]:
        """Its values by name, as reports have them."""
        return {**asdict(self.ground), "levelled": self.levelled}


def detect(
    opened: Opened,
    *,
    settings: DetectSettings = DETECT,
    threads: int | None = None,
    tally: Counter[str] | None = None,
    report: Reporter | None = None,
) -> Iterator[Detection]:
    """The tags in all frames of a recording, as they are found.

    Ready detections of a recording are passed on as they are.

    Args:
        opened: The recording; of an object, only its tags are taken.
        settings: How tags are looked for.
        threads: Images searched at the same time; None: one a core.
        tally: Filled with counts of tags found and rejected, by reason.
        report: Takes progress and problems.

    Yields:
        Detections, in order of time but for a batch of frames.

    Raises:
        FileError: A frame is no image.
        InputError: No tag was seen.
    """
    report = report or Reporter()
    tally = Counter() if tally is None else tally
    for problem in opened.problems:
        report.problem("detect", problem)
    cameras = f"{len(opened.cameras)} cameras"
    if opened.recording is None:
        report.message("detect", f"{opened.path}: {len(opened.detections)} ready detections of {cameras}")
        tally["tags"] += len(opened.detections)
        yield from opened.detections
        return
    n_frames = opened.recording.n_frames
    report.message("detect", f"{opened.path}: {n_frames} images of {cameras}")
    yield from detect_frames(
        opened.recording,
        opened.model,
        settings=settings,
        threads=threads or os.cpu_count() or 1,
        tally=tally,
        progress=report.counter("detect", n_frames, "images"),
    )
    if tally[DAMAGED]:
        report.problem("detect", f"{opened.path}: {tally[DAMAGED]} of {n_frames} frames are damaged and left out")
    if not tally["tags"]:
        rejected = ", ".join(f"{count} {what}" for what, count in sorted(tally.items()) if what.startswith("rejected"))
        cause = usual_cause(opened.recording, opened.model, settings=settings) or rejected
        raise InputError(f"{opened.path}: no tag was seen in {n_frames} images; {cause}")
    report.message("detect", f"detect: {tally['tags']} tags")


def counts(tally: Counter[str]) -> dict[str, int]:
    """The counts of a tally in the order of their names."""
    return {name: int(count) for name, count in sorted(tally.items())}


def track(
    opened: Opened,
    detections: Iterable[Detection],
    *,
    settings: TrackSettings = TRACK,
    spool_folder: Path | None = None,
    keep: Callable[[str, PoseTrack], None] | None = None,
    report: Reporter | None = None,
) -> Tracked:
    """The poses of all moving bodies in every frame that shows them, with what the graph calibrated on the way.

    Args:
        opened: The recording.
        detections: All of them, or an iterator that yields them in order of time as they are found.
        settings: When a pose is accepted. Of a recording without an object no accuracy is asked.
        spool_folder: Folder for a temporary file of detections that come from an iterator and are needed more than
            once; None: the system's.
        keep: Takes the poses instead: a body's name and the next stretch of its track.
        report: Takes progress and problems.

    Returns:
        Tracks by body (none where `keep` takes them), cameras, layout, and a report.

    Raises:
        InputError: No pose can be found.
    """
    report = report or Reporter()
    if opened.model is None:
        settings = replace(settings, max_sigma=float("inf"), max_angle_sigma=float("inf"))
    layout = opened.layout if opened.model is None else articulated(opened.layout, opened.model)
    if isinstance(detections, Sequence):
        detections = sorted(detections, key=lambda detection: detection.t)
    # detections that are still to be found are counted where they are found
    is_streamed = isinstance(detections, Iterator) and not needs_all(opened.cameras, layout, settings=settings)
    tracked = track_stream(
        detections,
        opened.cameras,
        layout,
        settings=settings,
        name=opened.name,
        progress=None if is_streamed else report.counter("track", None, "poses"),
        keep=keep,
        spool_folder=spool_folder,
    )
    _report_tracked(tracked, report)
    return tracked


def _report_tracked(tracked: Tracked, report: Reporter) -> None:
    found = tracked.report
    rms = f"reprojection {found.rms:.2f} px rms"
    report.message("track", f"track: {found.n_poses} poses in {found.n_steps} frames, {rms}")
    for reason, count in found.dropped_steps.items():
        report.message("track", f"  {count} frames without a pose: {reason}")
    for camera, n in found.sightings.items():
        reasons = Counter(found.left_out.get(camera, {}))
        line = f"camera {camera}: {reasons.total()} of {n} sightings of tags are left out ({words(reasons)})"
        if not n:
            report.problem("track", f"camera {camera} saw no tag of the scene ({words(Counter(found.dropped_tags))})")
        elif 2 * reasons.total() > n:
            report.problem("track", f"{line}; are its clock and its calibration right?")
        elif reasons:
            report.message("track", f"  {line}")
    for suspect in found.suspects:
        report.problem("track", suspect.message)
    others = [camera.name for camera in tracked.cameras if camera.name not in found.clocks]
    for camera, (offset, sigma) in found.clocks.items():
        side = f"{abs(offset):.3f} s {'ahead of' if offset > 0 else 'behind'} {others[0]}'s"
        exact = f"{abs(offset) * 1e3:.3f} ± {sigma * 1e3:.3f} ms"
        report.problem("track", f"camera {camera}'s clock is {side} ({exact}); its times are shifted")
    for camera, why in found.clock_doubts.items():
        report.problem("track", f"whether camera {camera}'s clock agrees cannot be told: {why}; its times are kept")
    for name in found.unplaced:
        report.problem("track", f"{name} was never seen together with anything of known pose")


def corrected_cameras(tracked: Tracked) -> tuple[Camera, ...]:
    """The cameras that tracking found, with the clock offsets that it found."""
    clocks = tracked.report.clocks
    return tuple(
        replace(camera, clock_offset=camera.clock_offset + clocks.get(camera.name, (0.0, 0.0))[0])
        for camera in tracked.cameras
    )


def object_name(opened: Opened) -> str:
    """The name of the object's body in the scene.

    Returns:
        The body's name in the layout.

    Raises:
        ObjectError: The object is no moving body of the scene.
    """
    model = opened.object()
    body = object_body(opened.layout, model.body_names)
    if body is None or body.is_static:
        names = ", ".join(body.name for body in opened.layout.bodies)
        raise ObjectError(f"object '{model.name}' is no moving body of the scene (its bodies: {names})")
    return body.name


def object_track(opened: Opened, tracked: Tracked) -> PoseTrack:
    """The track of the object's body, with its joints.

    Returns:
        The object's track.

    Raises:
        ObjectError: The object is no moving body of the scene.
        InputError: It has too few poses.
    """
    name = object_name(opened)
    if name not in tracked.tracks:
        raise too_few_poses(opened, name)
    return tracked.tracks[name]


def too_few_poses(opened: Opened, body: str) -> InputError:
    """The error that says that a body has no track."""
    return InputError(_with_causes(f"{opened.path}: too few poses of '{body}' for a track", opened, Reporter()))


def _with_causes(failure: str, opened: Opened, report: Reporter) -> str:
    """What failed, with the problems that were reported on the way, and what a second look at the images shows."""
    cause = None
    if opened.recording is not None:
        cause = usual_cause(opened.recording, opened.model, settings=DETECT)
    return "; ".join([failure, *report.problems, *([cause] if cause is not None else [])])


def level(
    opened: Opened, poses: PoseTrack | LongTrack, *, settings: TossSettings = SEGMENT, report: Reporter | None = None
) -> tuple[PoseTrack | LongTrack, Levelled | None]:
    """Poses in a world whose ground is z = 0, where the set-up does not say where the ground is.

    Args:
        opened: The recording with its object.
        poses: The object's track.
        settings: `level` says when the world is levelled: "auto" where no fixed tag says where the ground is and the
            ground found is off by more than `LEVEL_HEIGHT` or `LEVEL_TILT`.
        report: Takes findings and problems.

    Returns:
        The poses, levelled or as they were; and the ground, None where the track does not tell it.
    """
    report = report or Reporter()
    try:
        ground = find_ground(poses, opened.object(), gravity=settings.gravity)
    except InputError as error:
        report.message("level", f"ground: as the set-up has it ({error})")
        return poses, None
    is_off = bool(abs(ground.height) > LEVEL_HEIGHT or ground.tilt > LEVEL_TILT)
    has_fixed_tag = any(body.is_static and body.tags for body in opened.layout.bodies)
    levelled = settings.level == "always" or (settings.level == "auto" and is_off and not has_fixed_tag)
    tilt, slope = np.rad2deg(ground.tilt), np.rad2deg(float(np.linalg.norm(ground.slope)))
    sigma = 1e3 * float(np.sqrt(ground.cov[0, 0]))
    report.message(
        "level",
        f"ground: {1e3 * ground.height:.2f} mm high (± {sigma:.2f}), up is {tilt:.2f}° from z, it slopes by "
        f"{slope:.2f}°; from {ground.n_rests} rests and {ground.n_falling} frames of flight",
    )
    if levelled:
        report.problem("level", "the world is turned and shifted so that the ground is z = 0 (level=never leaves it)")
        return _levelled(poses, ground), Levelled(ground, levelled)
    if is_off:
        report.problem("level", "the world's z = 0 is not the ground; level=always turns and shifts it")
    return poses, Levelled(ground, levelled)


def _levelled(poses: PoseTrack | LongTrack, ground: Ground) -> LongTrack:
    """The track in the ground's frame, computed when it is read."""
    return LongTrack(poses.name, poses.t, lambda which: ground.levelled(poses.frames(which)))


def segment_tosses(
    opened: Opened, poses: PoseTrack | LongTrack, *, settings: TossSettings = SEGMENT, report: Reporter | None = None
) -> tuple[Sequence[PoseTrack], tuple[Stretch, ...]]:
    """The tracks of the tosses in an object's track, and the stretches between them.

    Args:
        opened: The recording with its object.
        poses: The object's track in a world whose ground is z = 0.
        settings: What counts as flight and as rest.
        report: Takes findings, and a problem where tosses do not fall by gravity.

    Returns:
        One track a toss, and every stretch that is none, with its reason.

    Raises:
        InputError: There is no toss.
    """
    report, model = report or Reporter(), opened.object()
    tracks, stretches = segment(poses, model, gravity=settings.gravity)
    report.message("segment", f"segment: {len(tracks)} tosses; {len(stretches)} stretches are none")
    for stretch in stretches:
        report.message("segment", f"  {stretch.t0:.2f} s to {stretch.t1:.2f} s: {stretch.reason}")
    if not tracks:
        failure = (
            f"no toss in {len(poses.t)} poses of '{model.name}'; see the reasons above, and whether the frames' times, "
            f"the tags' sizes and gravity={settings.gravity:g} are right"
        )
        raise InputError(_with_causes(failure, opened, report))
    said = fall_words(tracks, model, gravity=settings.gravity)
    if said is not None:
        report.problem("segment", f"{opened.path}: {said}")
    return tracks, stretches


def sessions(
    tracks: Sequence[PoseTrack],
    model: ObjectModel,
    *,
    settings: TossSettings = SEGMENT,
    report: Reporter | None = None,
) -> tuple[Sequence[PoseTrack], RecordingOrder]:
    """The sessions of tosses, and their tracks, those of tilted sessions in levelled worlds.

    Args:
        tracks: One a toss, as recorded.
        model: The object.
        settings: `level` says which sessions are levelled.
        report: Takes findings and problems.

    Returns:
        The tracks, and the order of recording with its sessions.
    """
    report = report or Reporter()
    found = find_sessions(
        tracks,
        model,
        level=settings.level,
        advance=report.counter("sessions", len(tracks), "tosses"),
    )
    for note in found.notes:
        report.message("sessions", f"sessions: {note}")
    say = report.message if len(found.sessions) == 1 else report.problem
    for session in found.sessions:
        say("sessions", f"{'session' if len(found.sessions) > 1 else 'one session'} {session_words(session)}")
    return levelled_tracks(tracks, found), found


def turned_back(
    tracks: Sequence[PoseTrack], model: ObjectModel, *, settings: IngestSettings, report: Reporter | None = None
) -> Turns | None:
    """The turns that take all throws to the x axis, of recordings that were turned about the vertical one by one.

    Args:
        tracks: One a toss, as recorded.
        model: The object.
        settings: `turned` says whether they are turned back.
        report: Takes findings and problems.

    Returns:
        The turns; None where recordings are kept as they are.
    """
    if settings.turned == "keep":
        return None
    report = report or Reporter()
    order, _, _ = recording_order(tracks)
    turns = find_turns(OnDemand(lambda i: tracks[order[i]], len(order), kept=0), model)
    report.message("sessions", f"{len(tracks)} tosses are turned about the vertical, so that all throws go along x")
    if turns.unknown:
        said = "show no direction of throw, and are turned like the toss before them"
        report.problem("sessions", f"{len(turns.unknown)} tosses {said}: {', '.join(turns.unknown)}")
    return turns
