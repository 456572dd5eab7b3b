"""The format `rosbag`: a recording of tag detections or camera images in ROS bags."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from tossid.errors import FileError
from tossid.vision.recordings.registry import Opened, register_recording


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


def _open(source: RosbagSource) -> Opened:
    """The bag's ready detections, or else its images."""
    from tossid.vision.recordings.bag_contents import has_detections, read_bag_detections, read_bag_images
    from tossid.vision.recordings.recording import read_set_up
    from tossid.vision.setup.tagslam import number

    path = source.path
    beside = path if path.is_dir() else path.parent
    folder = source.set_up or (beside if (beside / "cameras.yaml").is_file() else beside.parent)
    cameras, layout = read_set_up(folder)
    if source.images or not has_detections(path, cameras):
        return Opened.of(read_bag_images(path, folder), path)
    file = folder / "tagslam.yaml"
    sigma = number(file, "pixel_noise", layout.parameters.get("pixel_noise", 1.0))
    if sigma <= 0:
        raise FileError(file, f"pixel_noise is {sigma}, expected a positive number of pixels")
    ready = read_bag_detections(path, cameras, sigma=sigma)
    found, problems = ready.detections, ready.problems
    return Opened(path=path, folder=folder, cameras=cameras, layout=layout, detections=found, problems=problems)


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
