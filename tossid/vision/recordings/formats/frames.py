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
from tossid.vision.recordings.times import TIME_FILES, time_of_name, times_of

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
    from tossid.vision.recordings.recording import LATEST_NS, FrameFile, order_of

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
    stamps = times_of(folder / max(times), images) if times else [time_of_name(image) for image in images]
    beyond = [i for i, t_ns in enumerate(stamps) if abs(t_ns) > LATEST_NS]
    if beyond:
        raise FileError(path(beyond[0]), f"has the time stamp {stamps[beyond[0]]} ns, expected at most {LATEST_NS}")
    if abs(camera.clock_offset) * 1e9 > LATEST_NS / 4:
        raise FileError(folder, f"camera '{camera.name}' has a clock offset of {camera.clock_offset} s")
    t_ns = np.array(stamps, dtype=np.int64) - round(camera.clock_offset * 1e9)
    order = np.array(order_of(t_ns, path))
    return OnDemand(lambda i: FrameFile(camera.name, int(t_ns[order[i]]), path(order[i])), len(order), kept=0)


def _open(source: FramesSource) -> Opened:
    if source.path is None:
        raise ConfigError("source.path", "is needed; expected the folder of a recording.")
    found = read_recording(source.path)
    return Opened(path=source.path, folder=source.path, cameras=found.cameras, layout=found.layout, recording=found)


register_recording(FramesSource, _open, recognizes=lambda path: (path / "frames").is_dir())
