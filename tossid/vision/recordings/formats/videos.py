"""The format `video`: a recording with one video file a camera, read by OpenCV."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from tossid import budget
from tossid.errors import FileError
from tossid.settings.kinds import Positive
from tossid.vision.recordings.registry import Opened, register_recording
from tossid.vision.recordings.times import read_times

if TYPE_CHECKING:
    import cv2
    import numpy as np
    from numpy.typing import NDArray

    from tossid.vision.cameras.camera import Camera
    from tossid.vision.recordings.recording import FrameFile, Recording

    Image = NDArray[np.uint8]

VIDEO_SUFFIXES = (".mp4", ".avi", ".mkv", ".mov", ".m4v", ".webm")


@dataclass(frozen=True, kw_only=True)
class VideoSource:
    """Videos of the tagged object, one file a camera, with the cameras' calibration and the tags' layout."""

    name: Literal["video"] = "video"
    """videos"""
    path: Path
    """recording folder: CAMERA.mp4 for each camera, CAMERA.txt with its frames' times beside, or none"""
    rate_hz: Positive | None = None
    """frames a second where no file has times; null: what cameras.yaml or the videos say"""


class VideoFiles:
    """Frames of videos, one file a camera (OpenCV)."""

    def images(self, files: Sequence[FrameFile]) -> Iterator[Image]:
        """Frames by number, from the first on."""
        import cv2
        import numpy as np

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
    import cv2

    video = cv2.VideoCapture(str(path))
    if not video.isOpened():
        raise FileError(path, "is not a video that can be read")
    return video


def read_videos(folder: str | Path, *, rate_hz: float | None = None) -> Recording:
    """Open a recording of one video a camera: NAME/CAMERA.mp4 (or .avi, .mkv, .mov), with its calibration.

    A frame's time is a line of CAMERA.txt or CAMERA.csv beside the video, where there is one; else its number
    over the rate: that given, that of `cameras.yaml`, or the video's own.

    Args:
        folder: Where the videos and the calibration lie.
        rate_hz: Frames a second of all cameras; None: what the files say.

    Returns:
        The recording.

    Raises:
        FileError: A camera has no video, it cannot be read, or it and its times differ in length.
    """
    from tossid.vision.recordings.recording import Recording, read_set_up

    folder = Path(folder)
    cameras, layout = read_set_up(folder)
    frames = {camera.name: _list_video(folder, camera, rate_hz) for camera in cameras}
    return Recording(folder, cameras, layout, frames, VideoFiles())


def _list_video(folder: Path, camera: Camera, rate_hz: float | None) -> tuple[FrameFile, ...]:
    import cv2
    import numpy as np

    from tossid.vision.recordings.recording import FrameFile, in_order

    names = [folder / f"{camera.name}{suffix}" for suffix in VIDEO_SUFFIXES]
    path = next((name for name in names if name.is_file()), None)
    if path is None:
        raise FileError(folder, f"has no video of camera '{camera.name}'; expected {names[0].name} or alike")
    video = _open_video(path)
    count, own_rate = int(video.get(cv2.CAP_PROP_FRAME_COUNT)), float(video.get(cv2.CAP_PROP_FPS))
    width, height = (int(video.get(key)) for key in (cv2.CAP_PROP_FRAME_WIDTH, cv2.CAP_PROP_FRAME_HEIGHT))
    video.release()
    budget.check_pixels(path, width, height)
    budget.check_claim(path, "frames", count, budget.regular_size(path) // budget.limits().bytes_a_frame)
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


def _open(source: VideoSource) -> Opened:
    found = read_videos(source.path, rate_hz=source.rate_hz)
    return Opened(path=source.path, folder=source.path, cameras=found.cameras, layout=found.layout, recording=found)


def _has_videos(path: Path) -> bool:
    if not path.is_dir() or (path / "frames").exists() or (path / "metadata.yaml").is_file():
        return False
    return any(entry.name.endswith(VIDEO_SUFFIXES) for entry in path.iterdir())


register_recording(VideoSource, _open, recognizes=_has_videos)
