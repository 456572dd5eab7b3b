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

from experiments.vision.against_truth import tags_in_view
from pipelines.cli.call import call_with_keys
from pipelines.cli.console import Console
from pipelines.config.compose import load
from pipelines.config.schemas import IngestConfig
from pipelines.files.open_source import open_stage
from tossid.ingestion import stages
from tossid.motion import tosses_from_tracks
from tossid.objects import ObjectModel
from tossid.types import Detection, Frame
from tossid.vision.detection.detect import UNREFINED_SIGMA, TagFinder
from tossid.vision.recordings.npz import read_tracks
from tossid.vision.recordings.registry import Opened

Array = NDArray[np.float64]

FILM = ["seed=3", "camera.width=1280", "camera.height=1024", "camera.samples=12"]
TOSSES = (1, 4)
"""Of the films; the first is searched by both."""
IMAGES = 64
"""Of each camera so many images in a row are searched by both, about the release and the first impacts."""


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
            errors = np.concatenate([_errors(found, tags) for found, tags in zip(each.found, true, strict=True)])
            share = 100 * len(errors) / 4 / sum(map(len, true))
            ends = (f"{x:.3f}" for x in np.quantile(errors, (0.5, 0.95)))
            speed = (f"{1e3 * each.seconds / len(frames):.1f}", f"{bare.seconds / each.seconds:.1f}")
            rows.append([name, *speed, f"{share:.1f} %", *ends])
        heads = ["search", "ms an image", "times as fast", "of visible tags", "median error px", "95 % px"]
        console.table(heads, rows, title=f"Detection, {len(frames)} images of 1280 by 1024 px, one thread")
        heads = ["tosses", "s of film", "s of CPU: detect", "track", "segment", "s elapsed in all", "times real time"]
        rows = [[f"{n}", *_ingest(film)] for n, film in zip(TOSSES, films, strict=True)]
        console.table(heads, rows, title="ingest, three cameras of 1280 by 1024 px at 148 Hz")


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
    pose = q[int(np.argmin(np.abs(t - frame.t)))][None]
    camera = next(camera for camera in opened.cameras if camera.name == frame.camera)
    return {tag.id: pixels[0] for tag, pixels, seen in tags_in_view(model, camera, pose) if seen[0]}


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
