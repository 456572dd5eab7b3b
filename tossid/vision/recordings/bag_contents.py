"""What a recording takes from ROS bags: ready tag detections, or camera images."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tossid.errors import FileError
from tossid.types import Detection
from tossid.vision.cameras.camera import Camera
from tossid.vision.recordings.image_decoding import Pixels
from tossid.vision.recordings.recording import FrameFile, Recording, frames_in_order, read_set_up
from tossid.vision.recordings.rosbag import IMAGE_TYPES, Bag, as_defined, find_bags, grey_image, stamp


@dataclass(frozen=True, eq=False)
class BagDetections:
    """Ready detections of a bag.

    Attributes:
        detections: In order of recording.
        n_frames: Images that were searched, by camera.
        problems: What could not be read.
    """

    detections: tuple[Detection, ...]
    n_frames: dict[str, int]
    problems: tuple[str, ...]


def tag_topics(bag: Bag, cameras: Sequence[Camera]) -> dict[str, Camera]:
    """The topics of ready detections in a bag, each with its camera."""
    topics = {camera.tag_topic.lstrip("/"): camera for camera in cameras if camera.tag_topic}
    return {topic: camera for topic, camera in topics.items() if topic in bag.types}


def read_bag_detections(path: Path, cameras: Sequence[Camera], *, sigma: float) -> BagDetections:
    """AprilTag detections of the cameras' tag topics (`tagtopic` of cameras.yaml).

    Time is the message's own stamp, less the camera's clock offset. Corners are taken as they are: TagSLAM's
    detectors and calibrations share one pixel origin, which a bag does not name.

    Args:
        path: A bag, or a folder with bags.
        cameras: Their topics and clocks.
        sigma: Standard deviation of a corner along each axis [px].

    Returns:
        The detections.

    Raises:
        FileError: There is no bag, it is damaged, or it has none of these topics.
    """
    found: list[Detection] = []
    n_frames = dict.fromkeys((camera.name for camera in cameras), 0)
    problems: list[str] = []
    seen: list[str] = []
    used = False
    for file in find_bags(path):
        with Bag(file) as bag:
            topics = tag_topics(bag, cameras)
            seen += bag.types
            used |= bool(topics)
            for topic, t_ns, message in bag.messages(list(topics)):
                camera = topics[topic]
                n_frames[camera.name] += 1
                with as_defined(file, topic, message):
                    found += _detections(file, camera, stamp(message, t_ns), message, sigma)
            problems += bag.problems if topics else []
    if not used:
        wanted = ", ".join(camera.tag_topic or f"no tagtopic for {camera.name}" for camera in cameras)
        raise FileError(path, f"has no detections: topics {', '.join(seen) or 'none'}, wanted {wanted}")
    silent = [name for name, count in n_frames.items() if not count]
    problems += [f"{path}: camera {name} has no message" for name in silent]
    return BagDetections(tuple(found), n_frames, tuple(problems))


def _detections(path: Path, camera: Camera, t_ns: int, message: Any, sigma: float) -> list[Detection]:
    rows = getattr(message, "apriltags", None)
    rows = getattr(message, "detections", None) if rows is None else rows
    if rows is None:
        raise FileError(path, f"topic {camera.tag_topic} holds {message.__msgtype__}, expected AprilTag detections")
    t, cov = t_ns * 1e-9 - camera.clock_offset, np.tile(sigma**2 * np.eye(2), (4, 1, 1))
    found = []
    for row in rows:
        corners = np.array([[corner.x, corner.y] for corner in row.corners], dtype=float)
        if corners.shape != (4, 2) or not np.isfinite(corners).all():
            raise ValueError(f"a tag's corners are {corners.tolist()}")
        margin = float(getattr(row, "decision_margin", 0.0))
        found.append(Detection(camera.name, t, int(row.id), corners, cov, int(row.hamming), margin))
    return found


@dataclass(frozen=True)
class BagImages:
    """Frames that are images in bags.

    Attributes:
        topics: Topic of each camera.
    """

    topics: dict[str, str]

    def images(self, files: Sequence[FrameFile]) -> Iterator[Pixels | None]:
        """Messages by their time of recording."""
        if not files:
            return
        wanted = {file.index: i for i, file in enumerate(files)}
        found: list[Pixels | None] = [None] * len(files)
        path, topic = files[0].path, self.topics[files[0].camera]
        with Bag(path) as bag:
            for _, t_ns, message in bag.messages([topic], start=min(wanted), stop=max(wanted) + 1):
                if t_ns in wanted:
                    with as_defined(path, f"{topic} at {t_ns * 1e-9:.6f} s", message):
                        found[wanted[t_ns]] = grey_image(path, message)
        yield from found  # in order of their own stamps, which need not be that of recording


def image_topics(bag: Bag, cameras: Sequence[Camera]) -> dict[str, str]:
    """The topic of each camera's images in a bag (`rostopic` of cameras.yaml, plain or compressed)."""
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
        path: A bag, or a folder with one.
        folder: Folder of its calibration; None: the bag's.

    Returns:
        The recording.

    Raises:
        FileError: There is no bag, more than one with images, or a camera without images.
    """
    path = Path(path)
    folder = folder or (path if (path / "cameras.yaml").is_file() else path.parent)
    cameras, layout = read_set_up(folder)
    times: dict[str, list[tuple[int, int]]] = {camera.name: [] for camera in cameras}  # own, and of recording [ns]
    source = path
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
            topics, problems, source = here, bag.problems, file
            name_of = {topic: name for name, topic in topics.items()}
            for topic, t_ns, message in bag.messages(list(name_of)):
                with as_defined(file, topic, message):
                    times[name_of[topic]].append((stamp(message, t_ns), t_ns))
    silent = [camera for camera in cameras if not times[camera.name]]
    if silent:
        wanted = ", ".join(camera.image_topic or f"no rostopic for {camera.name}" for camera in silent)
        raise FileError(path, f"has no images of {silent[0].name}: topics {', '.join(seen) or 'none'}, wanted {wanted}")
    frames = {camera.name: _listed(camera, np.array(times[camera.name]), source) for camera in cameras}
    return Recording(folder, cameras, layout, frames, BagImages(topics), tuple(problems))


def _listed(camera: Camera, times: NDArray[np.int64], path: Path) -> Sequence[FrameFile]:
    return frames_in_order(camera, times[:, 0], lambda i: path, lambda i: int(times[i, 1]))


def has_detections(path: Path, cameras: Sequence[Camera]) -> bool:
    """Whether a bag, or one of a folder, has ready detections of the cameras."""
    for file in find_bags(path):
        with Bag(file) as bag:
            if tag_topics(bag, cameras):
                return True
    return False
