"""Recordings opened for the stages: frames, videos or bags, with their set-up and the object in them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

from pipelines.outputs import recover_folder
from pipelines.project import load_object, newest_recording, object_named, recorded_object
from pipelines.schemas import FramesSource, ObjectConfig, RosbagSource, VideoSource
from tossid.errors import FileError
from tossid.objects import ObjectModel
from tossid.types import Detection
from tossid.vision.camera import Camera
from tossid.vision.film import VIDEO_SUFFIXES, read_bag_images, read_videos
from tossid.vision.layout import TagLayout, object_tags
from tossid.vision.recording import Recording, read_recording, read_set_up
from tossid.vision.rosbag import Bag, find_bags, read_bag_detections, tag_topics
from tossid.vision.tagslam import number

CameraSource = FramesSource | VideoSource | RosbagSource


@dataclass(frozen=True)
class Opened:
    """A recording's set-up, and what there is of it.

    path: as named. model: the object with the tags that the set-up says it has, None where none is named.
    recording: of images, None where a bag has ready detections. detections: of these. problems: what was lost.
    """

    path: Path
    cameras: tuple[Camera, ...]
    layout: TagLayout
    model: ObjectModel | None
    recording: Recording | None
    detections: tuple[Detection, ...] = ()
    problems: tuple[str, ...] = ()

    @property
    def name(self) -> str:
        """Of the recording, for files that are made of it."""
        return recording_name(self.path)

    def images(self) -> Recording:
        """Its images. `FileError` where it has none."""
        if self.recording is None:
            raise FileError(self.path, "has tag detections and no images; 'tossid track' and 'tossid ingest' take them")
        return self.recording

    def object(self) -> ObjectModel:
        """The object. `FileError` where none is named."""
        if self.model is None:
            raise FileError(self.path, "does not say what was tossed; give object=NAME")
        return self.model


def recording_name(path: Path) -> str:
    """Of the recording that lies there."""
    return path.resolve().name.split(".")[0]


def source_at(path: Path) -> CameraSource:
    """What a path holds: frames, videos, or a bag."""
    if path.is_file() or (path / "metadata.yaml").is_file():
        return RosbagSource("rosbag", path, None, False)
    if path.is_dir() and not (path / "frames").exists():
        names = [entry.name for entry in path.iterdir()]
        if any(name.endswith(VIDEO_SUFFIXES) for name in names):
            return VideoSource("video", path, None)
        if any(".bag" in name or name.endswith((".mcap", ".db3")) for name in names):
            return RosbagSource("rosbag", path, None, False)
    return FramesSource("frames", path)


def open_recording(source: CameraSource, config: ObjectConfig | None, *, default: str | None = None) -> Opened:
    """The recording that a source names, with its object.

    Args:
        config: None for the object that the recording names. default: the object where it names none either.
    """
    path = source.path
    if path is not None:
        recover_folder(path)
    path = newest_recording() if path is None else path
    folder = path if path.is_dir() else path.parent
    if isinstance(source, RosbagSource):
        folder = source.set_up or (folder if (folder / "cameras.yaml").is_file() else folder.parent)
        cameras, layout = read_set_up(folder)
        if not source.images and _has_detections(path, cameras):
            sigma = number(folder / "tagslam.yaml", "pixel_noise", layout.parameters.get("pixel_noise", 1.0))
            if sigma <= 0:
                raise FileError(
                    folder / "tagslam.yaml", f"pixel_noise is {sigma}, expected a positive number of pixels"
                )
            found = read_bag_detections(path, cameras, sigma=sigma)
            model = _object(folder, layout, config, default)
            return Opened(path, cameras, layout, model, None, found.detections, found.problems)
        recording = read_bag_images(path, folder)
    elif isinstance(source, VideoSource):
        recording = read_videos(path, rate_hz=source.rate_hz)
    else:
        recording = read_recording(path)
    model = _object(folder, recording.layout, config, default)
    return Opened(path, recording.cameras, recording.layout, model, recording, problems=recording.problems)


def _has_detections(path: Path, cameras: tuple[Camera, ...]) -> bool:
    for file in find_bags(path):
        with Bag(file) as bag:
            if tag_topics(bag, cameras):
                return True
    return False


def _object(folder: Path, layout: TagLayout, config: ObjectConfig | None, default: str | None) -> ObjectModel | None:
    config = config or recorded_object(folder) or (object_named(default) if default is not None else None)
    if config is None:
        return None
    model = load_object(replace(config, tags=None))
    return replace(model, tags=object_tags(layout, model.body_names))
