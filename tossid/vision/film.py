"""Recordings whose frames are in videos or bags."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from tossid.errors import FileError
from tossid.vision.camera import Camera
from tossid.vision.recording import FrameFile, Recording, in_order, read_set_up
from tossid.vision.rosbag import IMAGE_TYPES, Bag, as_defined, find_bags, grey_image, stamp
from tossid.vision.times import read_times

VIDEO_SUFFIXES = (".mp4", ".avi", ".mkv", ".mov", ".m4v", ".webm")
Image = NDArray[np.uint8]


class VideoFiles:
    """Frames of videos, one file a camera (OpenCV)."""

    def images(self, files: Sequence[FrameFile]) -> Iterator[Image]:
        """Frames by number, from the first on."""
        if not files:
            return
        video = _open_video(files[0].path)
        try:
            at = files[0].index
            if at:
                video.set(cv2.CAP_PROP_POS_FRAMES, at)
            for file in files:
                image = None
                while at <= file.index:
                    good, image = video.read()
                    if not good:
                        raise FileError(file.path, f"breaks off at frame {at}; expected {file.index} and more")
                    at += 1
                assert image is not None
                grey = image if image.ndim == 2 else cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)
                yield np.ascontiguousarray(grey, dtype=np.uint8)
        finally:
            video.release()


def _open_video(path: Path) -> cv2.VideoCapture:
    video = cv2.VideoCapture(str(path))
    if not video.isOpened():
        raise FileError(path, "is not a video that can be read")
    return video


def read_videos(folder: str | Path, *, rate_hz: float | None = None) -> Recording:
    """Open a recording of one video a camera: NAME/CAMERA.mp4 (or .avi, .mkv, .mov), with its calibration.

    A frame's time is a line of CAMERA.txt or CAMERA.csv beside the video, where there is one; else its number
    over the rate: that given, that of `cameras.yaml`, or the video's own.

    Args:
        rate_hz: frames a second of all cameras.

    Raises:
        FileError: a camera has no video, it cannot be read, or it and its times differ in length.
    """
    folder = Path(folder)
    cameras, layout = read_set_up(folder)
    frames = {camera.name: _list_video(folder, camera, rate_hz) for camera in cameras}
    return Recording(folder, cameras, layout, frames, VideoFiles())


def _list_video(folder: Path, camera: Camera, rate_hz: float | None) -> tuple[FrameFile, ...]:
    names = [folder / f"{camera.name}{suffix}" for suffix in VIDEO_SUFFIXES]
    path = next((name for name in names if name.is_file()), None)
    if path is None:
        raise FileError(folder, f"has no video of camera '{camera.name}'; expected {names[0].name} or alike")
    video = _open_video(path)
    count, own_rate = int(video.get(cv2.CAP_PROP_FRAME_COUNT)), float(video.get(cv2.CAP_PROP_FPS))
    video.release()
    if count < 1:
        raise FileError(path, "is a video without frames")
    times = next((path.with_suffix(suffix) for suffix in (".txt", ".csv") if path.with_suffix(suffix).is_file()), None)
    if times is not None:
        stamps = [t_ns for _, t_ns in read_times(times)]
        if len(stamps) != count:
            raise FileError(times, f"has {len(stamps)} times for the {count} frames of {path.name}")
    else:
        rate = rate_hz or camera.rate_hz or own_rate
        if not rate or not np.isfinite(rate):
            raise FileError(path, "has no rate; give source.rate_hz, rate_hz in cameras.yaml, or a file of times")
        stamps = [round(i * 1e9 / rate) for i in range(count)]
    late = round(camera.clock_offset * 1e9)
    return in_order(FrameFile(camera.name, t_ns - late, path, i) for i, t_ns in enumerate(stamps))


@dataclass(frozen=True)
class BagImages:
    """Images in bags. topics: of each camera."""

    topics: dict[str, str]

    def images(self, files: Sequence[FrameFile]) -> Iterator[Image]:
        """Messages by their time of recording."""
        if not files:
            return
        wanted = {file.index for file in files}
        path, topic = files[0].path, self.topics[files[0].camera]
        with Bag(path) as bag:
            for _, t_ns, message in bag.messages([topic], start=min(wanted), stop=max(wanted) + 1):
                if t_ns in wanted:
                    with as_defined(path, f"{topic} at {t_ns * 1e-9:.6f} s", message):
                        image = grey_image(message)
                    yield image


def image_topics(bag: Bag, cameras: Sequence[Camera]) -> dict[str, str]:
    """Of each camera, its topic of images in a bag (`rostopic` of cameras.yaml, plain or compressed)."""
    found = {}
    for camera in cameras:
        plain = camera.image_topic.lstrip("/")
        for topic in (plain, f"{plain}/compressed"):
            if plain and bag.types.get(topic) in IMAGE_TYPES and camera.name not in found:
                found[camera.name] = topic
    return found


def read_bag_images(path: str | Path, folder: Path | None = None) -> Recording:
    """Open a bag's camera images as a recording.

    Args:
        path: of a bag, or of a folder with one. folder: of its calibration, by default that of the bag.

    Raises:
        FileError: no bag, more than one with images, or a camera without images.
    """
    path = Path(path)
    folder = folder or (path if (path / "cameras.yaml").is_file() else path.parent)
    cameras, layout = read_set_up(folder)
    frames: dict[str, list[FrameFile]] = {camera.name: [] for camera in cameras}
    topics: dict[str, str] = {}
    problems: list[str] = []
    seen: list[str] = []
    for file in find_bags(path):
        with Bag(file) as bag:
            here = image_topics(bag, cameras)
            seen += bag.types
            if not here:
                continue
            if topics:
                raise FileError(file, "is the second bag with images here; name the one to be read")
            topics, problems = here, bag.problems
            late = {camera.name: round(camera.clock_offset * 1e9) for camera in cameras}
            name_of = {topic: name for name, topic in topics.items()}
            for topic, t_ns, message in bag.messages(list(name_of)):
                name = name_of[topic]
                with as_defined(file, topic, message):
                    frames[name].append(FrameFile(name, stamp(message, t_ns) - late[name], file, t_ns))
    silent = [camera for camera in cameras if not frames[camera.name]]
    if silent:
        wanted = ", ".join(camera.image_topic or f"no rostopic for {camera.name}" for camera in silent)
        raise FileError(path, f"has no images of {silent[0].name}: topics {', '.join(seen) or 'none'}, wanted {wanted}")
    ordered = {name: in_order(files) for name, files in frames.items()}
    return Recording(folder, cameras, layout, ordered, BagImages(topics), tuple(problems))
