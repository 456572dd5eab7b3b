"""Recordings from frames and of a timeline, and how far detections in them are from the truth."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from tossid.objects import ObjectModel
from tossid.rotations import quat_normalize, transform, transform_points
from tossid.settings.rendering import RenderSettings
from tossid.synthesis.timeline import Filming, FilmTruth, Timeline, render_timeline
from tossid.types import Detection, Frame
from tossid.vision.cameras.camera import Camera
from tossid.vision.cameras.shutter import Exposure, poses_at
from tossid.vision.detection.detect import TagFinder
from tossid.vision.recordings.formats.frames import read_recording
from tossid.vision.recordings.recording import Recording
from tossid.vision.recordings.writing import RecordingWriter
from tossid.vision.rendering.render import Renderer
from tossid.vision.setup.faces import tag_corners
from tossid.vision.setup.layout import TagLayout, layout_of

Array = NDArray[np.float64]

IMAGES = RenderSettings(samples=8)


def write_recording(
    target: Path, cameras: Iterable[Camera], layout: TagLayout, frames: Sequence[Frame], *, exact: bool = False
) -> None:
    """Write a recording from frames as they come; exact: as PNG."""
    writer = RecordingWriter(target, cameras, layout)
    for frame in frames:
        writer.write(frame)
    for frame in frames if exact else ():
        path = target / "frames" / frame.camera / f"{round(frame.t * 1e9):019d}.jpg"
        path.unlink()
        cv2.imwrite(str(path.with_suffix(".png")), frame.image)


def film_of(
    timeline: Timeline,
    model: ObjectModel,
    cameras: tuple[Camera, ...],
    folder: Path,
    filming: Filming,
    settings: RenderSettings = IMAGES,
) -> tuple[Recording, FilmTruth]:
    """Render a timeline into a folder; returns the recording and the truth."""
    writer, rng = RecordingWriter(folder, cameras, layout_of(model), quality=90), np.random.default_rng(7)
    truth = render_timeline(timeline, model, cameras, writer, rng, settings=settings, filming=filming)
    return read_recording(folder), truth


def true_corners(camera: Camera, model: ObjectModel, q: Array, detection: Detection) -> Array:
    """Where a detected tag's corners are in the image, at a pose of the object (7,). (4, 2) [px]."""
    tag = next(tag for tag in model.tags if tag.id == detection.tag_id)
    return camera.project(transform_points(transform(q[:3], q[3:7]), tag_corners(tag)))


def corner_rms(detection: Detection, recording: Recording, model: ObjectModel, timeline: Timeline) -> float:
    """Rms distance of a detection's corners from the true ones [px]."""
    q = poses_at(timeline.t, timeline.q, np.array([detection.t]))[0]
    true = true_corners(recording.camera(detection.camera), model, q, detection)
    return float(np.sqrt(np.mean(np.sum((detection.corners - true) ** 2, axis=-1))))


def random_poses(n: int, seed: int = 3) -> Array:
    """Poses (n, 7) in view of the default rig."""
    rng = np.random.default_rng(seed)
    return np.array(
        [[*rng.uniform([-0.3, -0.3, 0.06], [0.3, 0.3, 0.4]), *quat_normalize(rng.normal(size=4))] for _ in range(n)]
    )


def shot(source: Renderer, q: Array, camera: str = "c", rng: np.random.Generator | None = None) -> NDArray[np.uint8]:
    """An image of an object that stands still in a configuration (nq,)."""
    return source.draw(Exposure(q[None], (0.0, 1.0)), camera, rng)


def corner_errors(source: Renderer, cameras: Iterable[Camera], model: ObjectModel, poses: Array) -> tuple[Array, Array]:
    """Detected minus true corners, and the width of a tag's cell [px], of every tag found. (n, 4, 2), (n,)."""
    errors, cells = [], []
    for q in poses:
        for camera in cameras:
            image = shot(source, q, camera.name)
            for detection in TagFinder(camera, model).find(Frame(camera.name, 0.0, image)):
                true = true_corners(camera, model, q, detection)
                errors.append(detection.corners - true)
                (ax, ay), (bx, by) = true[2] - true[0], true[3] - true[1]
                longest = np.linalg.norm(np.roll(true, -1, axis=0) - true, axis=1).max()
                cells.append(abs(ax * by - ay * bx) / 2 / longest / 8)
    return np.array(errors), np.array(cells)
