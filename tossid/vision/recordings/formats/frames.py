"""The format `frames`: a recording whose images are files, in a folder for each camera.

NAME/cameras.yaml, camera_poses.yaml, tagslam.yaml
NAME/frames/CAMERA/T_NS.jpg (or .png): grey images, named by their time stamp [ns] or in seconds (12.345.jpg), or
    under any names with a file of times beside them (`times.py`)
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from tossid.errors import ConfigError, FileError
from tossid.vision.recordings.registry import Opened, register_recording

if TYPE_CHECKING:
    from tossid.vision.cameras.camera import Camera
    from tossid.vision.recordings.recording import FrameFile, Recording

IMAGE_SUFFIXES = (".jpg", ".jpeg", ".png", ".bmp", ".pgm", ".tif", ".tiff")


@dataclass(frozen=True, kw_only=True)
class FramesSource:
    """Camera frames of the tagged object, with the cameras' calibration and the tags' layout."""

    name: Literal["frames"] = "frames"
    """camera frames"""
    path: Path | None = None
    """recording folder; null: the newest in data/raw"""


def read_recording(folder: str | Path) -> Recording:
    """Open a recording of image files: read its calibration and list its frames.

    Raises:
        FileError: what is missing or damaged, by name.
    """
    from tossid.vision.recordings.recording import Recording, read_set_up

    folder = Path(folder)
    cameras, layout = read_set_up(folder)
    known = {camera.name for camera in cameras}
    frames_dir = folder / "frames"
    if not frames_dir.is_dir():
        raise FileError(frames_dir, "no such folder; expected one folder of frames for each camera")
    for entry in sorted(frames_dir.iterdir()):
        if entry.is_dir() and entry.name not in known:
            raise FileError(entry, f"holds frames of a camera that cameras.yaml does not have ({', '.join(known)})")
    frames = {camera.name: _list_frames(frames_dir / camera.name, camera) for camera in cameras}
    return Recording(folder, cameras, layout, frames)


def _list_frames(folder: Path, camera: Camera) -> Sequence[FrameFile]:
    """The frames in a folder in order of time. An hour has hundreds of thousands: of each a name and a time stay."""
    import numpy as np

    from tossid.types import OnDemand
    from tossid.vision.recordings.recording import frames_in_order
    from tossid.vision.recordings.times import TIME_FILES, check_rate, names_as_times, times_of

    if not folder.is_dir():
        raise FileError(folder, f"no such folder; expected the frames of camera '{camera.name}'")
    found, times, strangers = [], [], []
    for entry in os.scandir(folder):
        if entry.name.startswith(".") or not entry.is_file():
            continue
        if entry.name in TIME_FILES:
            times.append(entry.name)
        elif entry.name.lower().endswith(IMAGE_SUFFIXES):
            found.append(os.fsencode(entry.name))
        else:
            strangers.append(entry.name)
    if strangers:
        raise FileError(folder / min(strangers), f"is neither an image nor a file of times ({', '.join(TIME_FILES)})")
    if not found:
        raise FileError(folder, f"has no frames of camera '{camera.name}'")
    names = np.sort(np.array(found))

    def path(i: int) -> Path:
        return folder / os.fsdecode(names[i])

    images = OnDemand(path, len(names), kept=0)
    if times:
        t_ns = times_of(folder / max(times), images)
    else:
        t_ns = names_as_times(images)
        check_rate(folder, t_ns, unit="ns", named=True)
    return frames_in_order(camera, t_ns, path)


def _open(source: FramesSource) -> Opened:
    if source.path is None:
        raise ConfigError("source.path", "is needed; expected the folder of a recording.")
    return Opened.of(read_recording(source.path), source.path)


register_recording(FramesSource, _open, recognizes=lambda path: (path / "frames").is_dir())
