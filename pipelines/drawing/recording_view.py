"""What `tossid view` shows, and how it is gathered from a recording: cameras, bodies in motion, tosses."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pipelines.cli.console import Console, reported
from pipelines.config.schemas import ViewConfig
from pipelines.files.open_source import DETECTIONS, POSES, open_stage, stage_detections, stage_file, stage_tracks
from tossid.errors import InputError, TossidError
from tossid.ingestion import stages
from tossid.ingestion.progress import Reporter
from tossid.motion import tosses_from_tracks
from tossid.motion.segmentation import segment
from tossid.objects import ObjectModel, body_poses
from tossid.rotations import quat_rotate
from tossid.types import Detection, PoseTrack, Toss
from tossid.vision.cameras.camera import Camera
from tossid.vision.cameras.shutter import poses_at
from tossid.vision.recordings.recording import FrameFile, Recording, read_set_up
from tossid.vision.recordings.registry import Opened
from tossid.vision.setup.faces import object_faces, tag_corners
from tossid.vision.setup.layout import Body, BodyTag, TagLayout, body_tags, object_body

Array = NDArray[np.float64]

SINCE_1970 = 1e8
"""Times beyond this are taken for dates [s]."""
GAP, SAME = 0.03, 2e-4
"""Poses are interpolated between frames no further apart; times no further apart are one [s]."""


@dataclass(frozen=True, eq=False)
class Moving:
    """A body's motion.

    Attributes:
        name: The body.
        t: Times (n,) [s].
        p: Positions (n, 3) [m].
        quat: Orientations (n, 4), wxyz.
        position_cov: Covariances of the positions (n, 3, 3) [m²]; None if not known.
        angle_sigma: Largest standard deviation of the orientation about any axis (n,) [rad]; None if not known.
        polygons: The body's faces (k, 3) [m], in its frame.
        tags: The tags on it.
    """

    name: str
    t: Array
    p: Array
    quat: Array
    position_cov: Array | None
    angle_sigma: Array | None
    polygons: tuple[Array, ...]
    tags: tuple[BodyTag, ...]

    def at(self, t: float) -> tuple[Array, Array] | None:
        """Its pose (3,), (4,) at a time, interpolated; None in a gap of more than `GAP`, and beyond its ends."""
        after = int(np.searchsorted(self.t, t - SAME))
        if after == len(self.t) or (after == 0 and self.t[0] - t > SAME):
            return None
        if abs(self.t[after] - t) <= SAME:
            return self.p[after], self.quat[after]
        if self.t[after] - self.t[after - 1] > GAP:
            return None
        own = slice(after - 1, after + 1)
        q = poses_at(self.t[own], np.concatenate([self.p[own], self.quat[own]], axis=1), np.array([t]))[0]
        return q[:3], q[3:]


MOST_IMAGES = 500
"""Where no key says how many there are: some 10 MB in a Rerun file."""


@dataclass(frozen=True, eq=False)
class ViewContent:
    """What a viewer displays.

    Attributes:
        name: The recording, or the dataset.
        cameras: The cameras.
        layout: The tags on the bodies.
        recording: Where images are read from.
        frames: For each camera, the frames whose images are displayed; None for none.
        detections: The tags that were found.
        moving: The bodies and their motions.
        tosses: The tosses.
        predicted: Rollouts, by what predicts.
        notes: Markdown text beside.
    """

    name: str
    cameras: tuple[Camera, ...] = ()
    layout: TagLayout | None = None
    recording: Recording | None = None
    frames: Mapping[str, Sequence[FrameFile]] | None = None
    detections: tuple[Detection, ...] = ()
    moving: tuple[Moving, ...] = ()
    tosses: tuple[Toss, ...] = ()
    predicted: Mapping[str, tuple[Moving, ...]] = field(default_factory=dict)
    notes: str = ""


def recording_content(config: ViewConfig, console: Console) -> ViewContent:
    """A recording with its detections and poses: those that stages left, else found now."""
    opened = open_stage(config.recording, config.object)
    for problem in opened.problems:
        console.warn(problem)
    cameras, layout = opened.cameras, opened.layout
    first, last = _stretch(config, opened)
    poses_file = config.poses or stage_file(opened, POSES)
    left: Sequence[PoseTrack] = ()
    if config.poses is not None or _left_by_a_stage(poses_file, opened, console):
        left = stage_tracks(opened, config.poses)
    detections = _detections(config, opened, console)
    if left:
        tracks = {track.name: track for track in left}
        set_up = poses_file.parent / f"{poses_file.stem}_set_up"
        if set_up.is_dir():
            cameras, layout = read_set_up(set_up)
    else:
        with reported(console) as progress:
            tracked = stages.track(opened, detections, settings=config.track, report=Reporter(progress))
        tracks, cameras, layout = tracked.tracks, stages.corrected_cameras(tracked), tracked.layout
    given = {camera.name: camera.clock_offset for camera in opened.cameras}
    late = {camera.name: camera.clock_offset - given.get(camera.name, 0.0) for camera in cameras}
    detections = tuple(replace(d, t=d.t - late[d.camera]) for d in detections)
    part = {name: piece for name, track in tracks.items() if (piece := _between(track, first, last)) is not None}
    frames = None
    if opened.recording is not None:
        frames = _frames(opened.recording, late, first, last)
        every = config.every or max(1, math.ceil(sum(map(len, frames.values())) / MOST_IMAGES))
        if every > 1:
            console.say(f"images of each {every}th frame; every=1 takes all")
        frames = {name: files[::every] for name, files in frames.items()}
    seen = tuple(d for d in detections if first <= d.t <= last)
    moving = moving_bodies(part, layout, opened.model)
    tosses = _tosses(tracks, opened.model, console)
    tosses = tuple(toss for toss in tosses if toss.t[-1] >= first and toss.t[0] <= last)
    return ViewContent(opened.name, cameras, layout, opened.recording, frames, seen, moving, tosses)


def _stretch(config: ViewConfig, opened: Opened) -> tuple[float, float]:
    """From when to when a recording is shown [s]. `InputError` where it has nothing then."""
    if opened.recording is not None:
        times = [file.t_ns * 1e-9 for files in opened.recording.frames.values() for file in files]
    else:
        times = [d.t for d in opened.detections]
    first = min(times, default=0.0) + config.start_s
    last = first + config.seconds if config.seconds is not None else float("inf")
    if not any(first <= t <= last for t in times):
        raise InputError(
            f"{opened.path}: has nothing from start_s={config.start_s:g} on; it ends at {max(times):.3f} s"
        )
    return first, last


def _detections(config: ViewConfig, opened: Opened, console: Console) -> Sequence[Detection]:
    given = config.detections is not None or opened.recording is None
    if given or _left_by_a_stage(stage_file(opened, DETECTIONS), opened, console):
        return stage_detections(opened, config.detections)
    with reported(console) as progress:
        report = Reporter(progress)
        return tuple(stages.detect(opened, settings=config.detect, threads=config.threads, report=report))


def _left_by_a_stage(file: Path, opened: Opened, console: Console) -> bool:
    """Whether a stage has left its file, and the recording is not newer."""
    if not file.is_file():
        return False
    folder = opened.path if opened.path.is_dir() else opened.path.parent
    set_up = folder / "cameras.yaml"
    if set_up.is_file() and set_up.stat().st_mtime > file.stat().st_mtime:
        console.say(f"{file} is older than the recording and is left aside")
        return False
    console.say(f"taking {file}")
    return True


def _between(track: PoseTrack, first: float, last: float) -> PoseTrack | None:
    own = slice(int(np.searchsorted(track.t, first)), int(np.searchsorted(track.t, last, side="right")))
    return track.frames(own) if own.stop - own.start > 1 else None


def _frames(recording: Recording, late: Mapping[str, float], first: float, last: float) -> dict[str, list[FrameFile]]:
    """Each camera's frames in a stretch of time, with the clocks' offsets that tracking found taken off."""
    found = {}
    for name, files in recording.frames.items():
        shifted = [replace(file, t_ns=file.t_ns - round(late[name] * 1e9)) for file in files]
        found[name] = [file for file in shifted if first <= file.t_ns * 1e-9 <= last]
    return found


def moving_bodies(
    tracks: Mapping[str, PoseTrack], layout: TagLayout | None, model: ObjectModel | None
) -> tuple[Moving, ...]:
    """The bodies that tracks move. A track of the object's joints too moves all its bodies."""
    found: list[Moving] = []
    for name, track in tracks.items():
        whole = model is not None and track.q.shape[1] == 7 + model.n_joints
        body = None if layout is None else layout.body(name)
        if model is not None and whole and (model.n_bodies > 1 or body is None or len(tracks) == 1):
            found += _of_model(track, model, layout)
            continue
        number = model.body_names.index(name) if model is not None and name in model.body_names else None
        polygons = () if model is None or number is None else _polygons(model, number)
        tags = () if body is None else _placed(body)
        found.append(_moving(name, track, track.q[:, :3], track.q[:, 3:7], polygons, tags))
    return tuple(found)


def _of_model(track: PoseTrack, model: ObjectModel, layout: TagLayout | None) -> list[Moving]:
    p, quat = body_poses(model, track.q)
    found = []
    for b, name in enumerate(model.body_names):
        tags = body_tags(model, b)
        if layout is not None and model.n_bodies == 1:
            own = object_body(layout, model.body_names)
            tags = tags if own is None else _placed(own)
        base = track if b == 0 else replace(track, q_cov=None)
        found.append(_moving(name, base, p[:, b], quat[:, b], _polygons(model, b), tags))
    return found


def _placed(body: Body) -> tuple[BodyTag, ...]:
    return tuple(tag for tag in body.tags if tag.T_body_tag is not None)


def _moving(
    name: str, track: PoseTrack, p: Array, quat: Array, polygons: tuple[Array, ...], tags: tuple[BodyTag, ...]
) -> Moving:
    cov, angle = None, None
    if track.q_cov is not None:
        cov = track.q_cov[:, :3, :3]
        angle = np.sqrt(np.maximum(np.linalg.eigvalsh(track.q_cov[:, 3:6, 3:6])[:, -1], 0.0))
    return Moving(name, track.t, p, quat, cov, angle, polygons, tags)


def _polygons(model: ObjectModel, body: int) -> tuple[Array, ...]:
    return tuple(face.polygon for face in object_faces(model) if face.body == body)


def _tosses(tracks: Mapping[str, PoseTrack], model: ObjectModel | None, console: Console) -> tuple[Toss, ...]:
    """The tosses in an object's track, with their phases."""
    if model is None:
        return ()
    track = next((t for t in tracks.values() if t.q.shape[1] == 7 + model.n_joints), None)
    if track is None or (model.n_bodies > 1 and model.n_joints == 0):
        return ()
    try:
        pieces, _ = segment(track, model)
        return tosses_from_tracks(pieces, model) if pieces else ()
    except TossidError as error:
        console.warn(f"no tosses are marked: {error}")
        return ()


def moments_of(content: ViewContent, camera: str) -> Array:
    """When a camera's frames are [s], or, of a recording without images, its detections. Increasing."""
    if content.frames is not None:
        return np.array([file.t_ns * 1e-9 for file in content.frames[camera]])
    return np.unique([d.t for d in content.detections if d.camera == camera])


def is_placed(camera: Camera) -> bool:
    """Whether a camera's pose in the world is known."""
    return camera.T_rig_cam is not None and camera.T_world_rig is not None


def faces_in_view(content: ViewContent, camera: Camera, t: float) -> tuple[Array, ...]:
    """Outlines (k, 2) [px] of the moving bodies' faces that look at a camera at a time."""
    found = []
    for body in content.moving:
        pose = body.at(t)
        if pose is None:
            continue
        outlines = body.polygons or tuple(tag_corners(tag) for tag in body.tags)
        for polygon in outlines:
            world = quat_rotate(pose[1], polygon) + pose[0]
            normal = np.cross(world[1] - world[0], world[2] - world[1])
            if normal @ (camera.T_world_cam[:3, 3] - world[0]) > 0:
                found.append(camera.project(world))
    return tuple(found)


def misplaced(content: ViewContent, camera: Camera, found: Sequence[Detection]) -> float | None:
    """Rms distance of found tags' corners from where the bodies' poses put them [px]; None where none is placed."""
    square = []
    for detection in found:
        for body in content.moving:
            tag = next((tag for tag in body.tags if tag.id == detection.tag_id), None)
            pose = None if tag is None else body.at(detection.t)
            if tag is not None and pose is not None:
                world = quat_rotate(pose[1], tag_corners(tag)) + pose[0]
                square.append(np.sum((camera.project(world) - detection.corners) ** 2, axis=-1))
    return float(np.sqrt(np.mean(square))) if square else None
