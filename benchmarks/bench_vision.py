"""The vision part of `make bench`: detection beside the bare AprilTag library, and `ingest` beside real time.

    python -m benchmarks.bench_vision

Filmed tosses (a hand, the toss, rest), three cameras of 1280 by 1024 px, with their truth. CPU time on one thread;
of the images that both search, the bare library takes each whole at full resolution.
"""

from __future__ import annotations

import tempfile
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from pupil_apriltags import Detector

from pipelines.cli.call import call_with_keys
from pipelines.cli.console import Console
from pipelines.config.compose import load
from pipelines.config.schemas import IngestConfig
from pipelines.files.open_source import open_stage
from tossid.ingestion import stages
from tossid.motion import tosses_from_tracks
from tossid.objects import ObjectModel, Tag
from tossid.rotations import quat_normalize, transform, transform_from_rotvec, transform_inv, transform_points
from tossid.settings.ingestion import DetectSettings
from tossid.settings.rendering import RenderSettings
from tossid.types import Detection, Frame
from tossid.vision.cameras.camera import Camera
from tossid.vision.cameras.rig import default_rig
from tossid.vision.detection.detect import UNREFINED_SIGMA, TagFinder
from tossid.vision.pose_graph.track import track_scene
from tossid.vision.recordings.npz import read_tracks
from tossid.vision.recordings.registry import Opened
from tossid.vision.rendering.render import Renderer
from tossid.vision.setup.faces import tag_corners
from tossid.vision.setup.layout import SQUARE, Body, BodyTag, TagLayout

Array = NDArray[np.float64]

FILM = ["seed=3", "camera.width=1280", "camera.height=1024", "camera.samples=12"]
TOSSES = (1, 4)
"""Of the films; the first is searched by both."""
IMAGES = 64
"""Of each camera so many images in a row are searched by both, about the release and the first impacts."""
LEVELS = ((1.5, 0.3), (1.5, 0.5), (1.5, 1.0), (1.5, 1.6), (4.0, 0.5), (4.0, 1.0), (8.0, 0.5), (8.0, 1.0))
"""Noise [grey levels] and blur [px] at which corners are compared with the truth, in `POSES` poses each."""
POSES = 15
STEPS = (300, 1500)
"""Of the recordings by a moving rig."""
PIXEL_NOISE = 0.2
"""Of their corners [px]."""
FACING = 0.25
"""A tag counts as visible where its normal is within acos of this of the way to the camera."""


class Search(NamedTuple):
    """seconds: of CPU time. found: for each image its detections."""

    seconds: float
    found: list[list[Detection]]


def vision(console: Console) -> None:
    """Print the tables."""
    with tempfile.TemporaryDirectory() as folder:
        films = [Path(folder) / f"film_{n}" for n in TOSSES]
        for n, film in zip(TOSSES, films, strict=True):
            call_with_keys("synthesize", [*FILM, f"tosses={n}", f"out={film}"], json=False, quiet=True)
        opened = open_stage(films[0], None)
        model, (truth,) = opened.object(), read_tracks(films[0] / "truth_poses.npz")
        frames = list(_frames(opened))
        bare, ours = _bare(frames), _ours(frames, opened, model)
        true = [_visible(model, opened, frame, truth.t, truth.q) for frame in frames]
        rows = []
        for name, each in (("AprilTag library, whole images", bare), ("tossid, predicted", ours)):
            right = [_errors(found, tags) for found, tags in zip(each.found, true, strict=True)]
            errors = np.concatenate([error for error in right if len(error)])
            rows.append(
                [
                    name,
                    f"{1e3 * each.seconds / len(frames):.1f}",
                    f"{bare.seconds / each.seconds:.1f}",
                    f"{100 * len(errors) / 4 / sum(map(len, true)):.1f} %",
                    f"{np.median(errors):.3f}",
                    f"{np.quantile(errors, 0.95):.3f}",
                ]
            )
        heads = ["search", "ms an image", "times as fast", "of visible tags", "median error px", "95 % px"]
        console.table(heads, rows, title=f"Detection, {len(frames)} images of 1280 by 1024 px, one thread")
        heads = ["noise grey levels", "blur px", "tags", "median error px", "95 % px", "NEES / expected"]
        console.table(heads, _corners(model), title="Corners, random poses of 640 by 512 px images")
        heads = ["tosses", "s of film", "s of CPU: detect", "track", "segment", "s elapsed in all", "times real time"]
        rows = [[f"{n}", *_ingest(film)] for n, film in zip(TOSSES, films, strict=True)]
        console.table(heads, rows, title="ingest, three cameras of 1280 by 1024 px at 148 Hz")
    heads = ["time steps", "detections", "s of CPU time", "reprojection px"]
    console.table(heads, map(_tracked, STEPS), title="Tracker, a moving rig of four cameras before 35 tags, one known")


def _tracked(n: int) -> list[str]:
    """A row: the CPU time of tracking n time steps."""
    detections, cameras, layout = moving_rig(n, np.random.default_rng(0))
    track_scene(*moving_rig(20, np.random.default_rng(1)))  # compiling
    started = time.process_time()
    tracked = track_scene(detections, cameras, layout)
    seconds = time.process_time() - started
    return [f"{n}", f"{len(detections)}", f"{seconds:.1f}", f"{tracked.report.rms:.3f}"]


def moving_rig(n: int, rng: np.random.Generator) -> tuple[list[Detection], list[Camera], TagLayout]:
    """What four cameras on a moving rig see of 35 tags, of which one is known: some ten tags an image.

    Args:
        n: Time steps.
        rng: Of noise, and of which tags are missed.
    """
    x, y = (axis.reshape(-1) for axis in np.meshgrid(np.linspace(-1.5, 1.5, 7), np.linspace(-1.0, 1.0, 5)))
    T_lab_tag = transform(np.stack([x, y, 3.0 + 0.3 * np.sin(3 * x + y)], axis=1), np.tile([0.0, 1, 0, 0], (35, 1)))
    tags = tuple(BodyTag(i, 0.16, T if i == 17 else None) for i, T in enumerate(T_lab_tag))
    layout = TagLayout((Body("lab", True, np.eye(4), 0.16, tags), Body("rig", False)))
    cameras = [
        Camera(
            f"cam{k}",
            (1280, 1024),
            np.array([700.0, 700, 640, 512]),
            rig_body="rig",
            T_world_rig=None,
            T_rig_cam=transform_from_rotvec(np.array([0.2 * (k % 2), 0.2 * (k // 2), 0.0]), np.array([0, 0.1 * k, 0])),
        )
        for k in range(4)
    ]
    corners = transform_points(T_lab_tag, 0.08 * SQUARE)
    cov, detections = np.tile(PIXEL_NOISE**2 * np.eye(2), (4, 1, 1)), []
    for t in np.arange(n) / 20:
        shift = [0.8, 0.5, 0.6] * np.sin(t * np.array([0.7, 0.9, 0.5]) + np.arange(3))
        T_lab_rig = transform_from_rotvec(shift, 0.25 * np.sin(0.6 * t + 1) * np.array([0.6, 0.8, 0.0]))
        for camera in cameras:
            assert camera.T_rig_cam is not None
            here = transform_points(transform_inv(T_lab_rig @ camera.T_rig_cam), corners.reshape(-1, 3))
            pixels = camera.distort(here)[0].reshape(-1, 4, 2) + PIXEL_NOISE * rng.normal(size=(len(tags), 4, 2))
            seen = (here.reshape(-1, 4, 3)[..., 2] > 0.3).all(axis=1) & (rng.uniform(size=len(tags)) > 0.66)
            for i in np.flatnonzero(seen):
                if camera.contains(pixels[i], margin=5).all():
                    detections.append(Detection(camera.name, float(t), int(i), pixels[i], cov))
    return detections, cameras, layout


def _corners(model: ObjectModel) -> Iterator[list[str]]:
    """Rows: corners' errors over noise and blur, and what their covariances say of them, in random poses."""
    cameras = default_rig(n_cameras=2)
    for noise, blur in LEVELS:
        renderer, rng = Renderer(model, cameras, RenderSettings(noise=noise, blur=blur)), np.random.default_rng(1)
        errors, covs = [], []
        for _ in range(POSES):
            q = np.array([*rng.uniform([-0.3, -0.3, 0.06], [0.3, 0.3, 0.4]), *quat_normalize(rng.normal(size=4))])
            T = transform(q[:3], q[3:7])
            for camera in cameras:
                frame = Frame(camera.name, 0.0, renderer.render(q, q, camera.name, rng))
                true = {tag.id: camera.project(transform_points(T, tag_corners(tag))) for tag in model.tags}
                found = TagFinder(camera, model, DetectSettings(predict=False)).find(frame)
                errors += [d.corners - true[d.tag_id] for d in found]
                covs += [d.corner_cov for d in found]
        error, cov = np.array(errors), np.array(covs)
        nees = np.einsum("nci,ncij,ncj->nc", error, np.linalg.inv(cov), error) / 2
        distance = np.linalg.norm(error, axis=-1)
        yield [
            f"{noise:.1f}",
            f"{blur:.1f}",
            f"{len(errors)}",
            f"{np.median(distance):.3f}",
            f"{np.quantile(distance, 0.95):.3f}",
            f"{nees.mean():.2f}",
        ]


def _frames(opened: Opened) -> Iterator[Frame]:
    """Images of each camera in turn, in order of time."""
    recording = opened.images()
    for files in recording.frames.values():
        first = max(len(files) // 2 - IMAGES // 2, 0)
        yield from recording.run(files[first : first + IMAGES])


def _bare(frames: Sequence[Frame]) -> Search:
    detector = Detector(families="tag36h11", nthreads=1, quad_decimate=1.0)
    detector.detect(frames[0].image)
    found, started = [], time.process_time()
    raw = [detector.detect(frame.image) for frame in frames]
    seconds = time.process_time() - started
    cov = np.tile(UNREFINED_SIGMA**2 * np.eye(2), (4, 1, 1))
    for frame, rows in zip(frames, raw, strict=True):
        found.append([Detection(frame.camera, frame.t, row.tag_id, row.corners - 0.5, cov) for row in rows])
    return Search(seconds, found)


def _ours(frames: Sequence[Frame], opened: Opened, model: ObjectModel) -> Search:
    seconds, found = 0.0, []
    for camera in opened.cameras:
        own = [frame for frame in frames if frame.camera == camera.name]
        TagFinder(camera, model, layout=opened.layout).find(own[0])  # the lens's table, and compiling
        finder, started = TagFinder(camera, model, layout=opened.layout), time.process_time()
        found += [finder.find(frame) for frame in own]
        seconds += time.process_time() - started
    return Search(seconds, found)


def _visible(model: ObjectModel, opened: Opened, frame: Frame, t: Array, q: Array) -> dict[int, Array]:
    """True corners (4, 2) [px] of the tags that face the camera, by id."""
    pose = q[int(np.argmin(np.abs(t - frame.t)))]
    T = transform(pose[:3], pose[3:7])
    camera = next(camera for camera in opened.cameras if camera.name == frame.camera)
    corners = {tag.id: camera.project(transform_points(T, tag_corners(tag))) for tag in model.tags}
    return {
        tag.id: corners[tag.id]
        for tag in model.tags
        if _faces(tag, T, camera) and camera.contains(corners[tag.id], margin=5).all()
    }


def _faces(tag: Tag, T: Array, camera: Camera) -> bool:
    way = camera.T_world_cam[:3, 3] - (T @ tag.T_body_tag)[:3, 3]
    return bool(T[:3, :3] @ tag.T_body_tag[:3, 2] @ way > FACING * np.linalg.norm(way))


def _errors(found: Sequence[Detection], true: dict[int, Array]) -> Array:
    """Distance of each corner of a visible tag from its true place [px]; a tag that is elsewhere is not found."""
    errors = [np.linalg.norm(d.corners - true[d.tag_id], axis=1) for d in found if d.tag_id in true]
    return np.concatenate([np.zeros(0), *(error for error in errors if error.max() < 5)])


def _ingest(film: Path) -> list[str]:
    """The film's length, the stages' CPU seconds, and the elapsed time of all of it: the less of two runs."""
    opened = open_stage(film, None)
    config: IngestConfig = load("ingest", IngestConfig, [f"source.path={film}"])
    started = [time.process_time()]
    detections = list(stages.detect(opened, settings=config.detect, threads=1))
    started.append(time.process_time())
    tracked = stages.track(opened, detections, settings=config.track)
    started.append(time.process_time())
    poses = stages.object_track(opened, tracked)
    tracks, _ = stages.segment_tosses(opened, poses, settings=config)
    tosses_from_tracks(tracks, opened.object(), gravity=config.gravity)
    started.append(time.process_time())
    elapsed = []
    for k in range(2):
        before, out = time.perf_counter(), film.parent / f"{film.name}_{k}.h5"
        call_with_keys("ingest", [f"source.path={film}", f"out={out}"], json=False, quiet=True)
        elapsed.append(time.perf_counter() - before)
    length = float(poses.t[-1] - poses.t[0])
    times = [f"{seconds:.2f}" for seconds in (length, *np.diff(started), min(elapsed))]
    return [*times, f"{min(elapsed) / length:.1f}"]


if __name__ == "__main__":
    vision(Console())
