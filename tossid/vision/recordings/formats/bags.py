"""The format `rosbag`: a recording of tag detections or camera images in ROS bags."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from tossid.errors import FileError
from tossid.vision.recordings.registry import Opened, register_recording

if TYPE_CHECKING:
    from tossid.types import Detection
    from tossid.vision.cameras.camera import Camera
    from tossid.vision.recordings.image_decoding import Pixels
    from tossid.vision.recordings.recording import FrameFile, Recording
    from tossid.vision.recordings.rosbag import Bag


@dataclass(frozen=True, kw_only=True)
class RosbagSource:
    """A ROS 1 or ROS 2 bag: AprilTag detections (apriltag_msgs) or camera images (sensor_msgs)."""

    name: Literal["rosbag"] = "rosbag"
    """ROS bags"""
    path: Path
    """a bag (.bag, .bag.bz2, .mcap, or a ROS 2 bag's folder), or a folder with one"""
    set_up: Path | None = None
    """folder of cameras.yaml, camera_poses.yaml and tagslam.yaml; null: the bag's"""
    images: bool = False
    """detect tags in the bag's images even where it has detections"""


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
    from tossid.vision.recordings.rosbag import Bag, as_defined, find_bags, stamp

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
    import numpy as np

    from tossid.types import Detection

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
        from tossid.vision.recordings.rosbag import Bag, as_defined, grey_image

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
    from tossid.vision.recordings.rosbag import IMAGE_TYPES

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
    from tossid.vision.recordings.recording import FrameFile, Recording, in_order, read_set_up
    from tossid.vision.recordings.rosbag import Bag, as_defined, find_bags, stamp

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


def _open(source: RosbagSource) -> Opened:
    """The bag's ready detections, or else its images."""
    from tossid.vision.recordings.recording import read_set_up
    from tossid.vision.setup.tagslam import number

    path, folder = source.path, _set_up_folder(source)
    cameras, layout = read_set_up(folder)
    if source.images or not _has_detections(path, cameras):
        found = read_bag_images(path, folder)
        return Opened(
            path=path, folder=folder, cameras=cameras, layout=layout, recording=found, problems=found.problems
        )
    file = folder / "tagslam.yaml"
    sigma = number(file, "pixel_noise", layout.parameters.get("pixel_noise", 1.0))
    if sigma <= 0:
        raise FileError(file, f"pixel_noise is {sigma}, expected a positive number of pixels")
    ready = read_bag_detections(path, cameras, sigma=sigma)
    return Opened(
        path=path,
        folder=folder,
        cameras=cameras,
        layout=layout,
        detections=ready.detections,
        problems=ready.problems,
    )


def _set_up_folder(source: RosbagSource) -> Path:
    folder = source.path if source.path.is_dir() else source.path.parent
    return source.set_up or (folder if (folder / "cameras.yaml").is_file() else folder.parent)


def _has_detections(path: Path, cameras: tuple[Camera, ...]) -> bool:
    from tossid.vision.recordings.rosbag import Bag, find_bags

    for file in find_bags(path):
        with Bag(file) as bag:
            if tag_topics(bag, cameras):
                return True
    return False


def _is_bag(path: Path) -> bool:
    """A file is a bag; so is a folder that is one, or has one in it and no images."""
    from tossid.vision.recordings.rosbag import SUFFIXES, is_bag_folder

    if path.is_file() or is_bag_folder(path):
        return True
    if not path.is_dir() or (path / "frames").exists():
        return False
    return any(
        ".bag" in entry.name or entry.name.endswith(SUFFIXES) or is_bag_folder(entry) for entry in path.iterdir()
    )


register_recording(RosbagSource, _open, recognizes=_is_bag)
