"""A recording: camera frames with their calibration and tag layout.

NAME/cameras.yaml, camera_poses.yaml, tagslam.yaml
NAME/frames/CAMERA/T_NS.jpg (or .png): grey images, named by their time stamp [ns] or in seconds (12.345.jpg), or
    under any names with a file of times beside them (`times.py`)
"""

from __future__ import annotations

import itertools
import os
import shutil
import tempfile
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from types import TracebackType
from typing import Protocol

import cv2
import numpy as np
from numpy.typing import NDArray

from tossid.errors import FileError, InputError, OutputError
from tossid.types import Frame, OnDemand
from tossid.vision.calibration import read_cameras, write_cameras
from tossid.vision.camera import Camera
from tossid.vision.layout import TagLayout
from tossid.vision.tagslam import read_tagslam, write_tagslam
from tossid.vision.times import TIME_FILES, time_of_name, times_of

LATEST_NS = 1 << 62
"""No clock shows a time beyond this: it is the year 2116."""
IMAGE_SUFFIXES = (".jpg", ".jpeg", ".png", ".bmp", ".pgm", ".tif", ".tiff")
_ENDINGS = {b"\xff\xd8\xff": b"\xff\xd9", b"\x89PNG": b"IEND\xaeB`\x82"}


@dataclass(frozen=True, slots=True)
class FrameFile:
    """Where a frame is. t_ns: time stamp [ns], the camera's clock offset taken off. path: of an image, a video or
    a bag. index: number of the frame in a video, time of recording [ns] in a bag."""

    camera: str
    t_ns: int
    path: Path
    index: int = 0


class FrameReader(Protocol):
    """What gets at the images of a recording."""

    def images(self, files: Sequence[FrameFile]) -> Iterator[NDArray[np.uint8]]:
        """Grey images (height, width) of some frames of one camera, in order of time."""
        ...


class ImageFiles:
    """Frames that are image files."""

    def images(self, files: Sequence[FrameFile]) -> Iterator[NDArray[np.uint8]]:
        """One file a frame."""
        return (read_image(file.path) for file in files)


@dataclass(frozen=True, eq=False)
class Recording:
    """A recording on disk; frames are read when asked for.

    cameras: in the order of `cameras.yaml`. layout: bodies and tags.
    frames: of each camera by name, in order of time. reader: of their images. problems: what of it was lost.
    """

    folder: Path
    cameras: tuple[Camera, ...]
    layout: TagLayout
    frames: Mapping[str, Sequence[FrameFile]]
    reader: FrameReader = field(default_factory=ImageFiles)
    problems: tuple[str, ...] = ()

    @property
    def n_frames(self) -> int:
        """Frames of all cameras together."""
        return sum(len(files) for files in self.frames.values())

    @property
    def rate_hz(self) -> float:
        """Frames a second of one camera, the median over their time steps. NaN with fewer than two frames."""
        steps = [np.diff([file.t_ns for file in files]) for files in self.frames.values() if len(files) > 1]
        return float(1e9 / np.median(np.concatenate(steps))) if steps else float("nan")

    def camera(self, name: str) -> Camera:
        """The camera of that name."""
        return next(camera for camera in self.cameras if camera.name == name)

    def read(self, file: FrameFile) -> Frame:
        """Read one frame (see `run`)."""
        return next(self.run((file,)))

    def run(self, files: Sequence[FrameFile]) -> Iterator[Frame]:
        """Read frames of one camera, in order of time.

        Raises:
            FileError: one is missing, no image, cut short, or not of the camera's resolution.
        """
        for file, image in zip(files, self.reader.images(files), strict=True):
            width, height = self.camera(file.camera).resolution
            if image.shape != (height, width):
                raise FileError(
                    file.path,
                    f"is {image.shape[1]} by {image.shape[0]} px, but {file.camera} has {width} by {height} px",
                )
            yield Frame(file.camera, file.t_ns * 1e-9, image)

    def __iter__(self) -> Iterator[Frame]:
        """All frames in order of time."""
        files = sorted((file for own in self.frames.values() for file in own), key=lambda file: file.t_ns)
        return (self.read(file) for file in files)


def read_image(path: Path) -> NDArray[np.uint8]:
    """A grey image (height, width). `FileError` if the file is none, or is cut short."""
    try:
        content = path.read_bytes()
    except OSError as error:
        raise FileError(path, f"cannot be read: {error.strerror}") from error
    for start, end in _ENDINGS.items():
        # OpenCV fills up what is missing of such a file with grey
        if content.startswith(start) and end not in content[-64:]:
            raise FileError(path, "is an image that breaks off before its end")
    try:
        image = cv2.imdecode(np.frombuffer(content, dtype=np.uint8), cv2.IMREAD_GRAYSCALE) if content else None
    except cv2.error:
        image = None
    if image is None:
        raise FileError(path, "is not an image that can be read")
    return np.asarray(image, dtype=np.uint8)


def read_set_up(folder: str | Path) -> tuple[tuple[Camera, ...], TagLayout]:
    """The cameras and the tag layout of a folder.

    Raises:
        FileError: what is missing or damaged, by name.
    """
    folder = Path(folder)
    if not folder.is_dir():
        raise FileError(folder, "no such folder; expected a recording (cameras.yaml, tagslam.yaml, frames/)")
    layout = read_tagslam(folder / "tagslam.yaml")
    return read_cameras(folder, layout=layout), layout


def read_recording(folder: str | Path) -> Recording:
    """Open a recording of image files: read its calibration and list its frames.

    Raises:
        FileError: what is missing or damaged, by name.
    """
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
    order = np.array(_order(t_ns, path))
    return OnDemand(lambda i: FrameFile(camera.name, int(t_ns[order[i]]), path(order[i])), len(order), kept=0)


def in_order(files: Iterable[FrameFile]) -> tuple[FrameFile, ...]:
    """Frames of one camera in order of time. `FileError` where two have one time stamp."""
    given = tuple(files)
    return tuple(given[i] for i in _order([file.t_ns for file in given], lambda i: given[i].path))


def _order(t_ns: Sequence[int] | NDArray[np.int64], path: Callable[[int], Path]) -> list[int]:
    """Frames' places in order of time. `FileError` where two have one time stamp; path: where a frame lies."""
    order = sorted(range(len(t_ns)), key=t_ns.__getitem__)
    for one, other in itertools.pairwise(order):
        if t_ns[one] == t_ns[other]:
            raise FileError(path(other), f"has the same time stamp as {path(one).name}")
    return order


class RecordingWriter:
    """Writes a recording whole or not at all.

    Use it as a context: frames go to a hidden folder beside the target, which
    takes the target's place when the context ends well, and vanishes otherwise
    (an error, Ctrl-C). Further files (truth) may be put into `folder` meanwhile.

    Args:
        target: the recording's folder. What is there is replaced at the end.
        cameras, layout: calibration and tags.
        image_format: "jpg" or "png". quality: of JPEG, 1 to 100.

    Raises:
        OutputError: the disk is full, read-only, or not ours to write.
    """

    def __init__(
        self,
        target: str | Path,
        cameras: Iterable[Camera],
        layout: TagLayout,
        *,
        image_format: str = "jpg",
        quality: int = 80,
    ) -> None:
        if image_format not in ("jpg", "png"):
            raise InputError(f"image format '{image_format}' is not one of jpg, png")
        if not 1 <= quality <= 100:
            raise InputError(f"JPEG quality {quality} is not within 1 to 100")
        self.target = Path(target)
        self.cameras = tuple(cameras)
        self.layout = layout
        self._suffix = f".{image_format}"
        jpeg = [cv2.IMWRITE_JPEG_QUALITY, quality, cv2.IMWRITE_JPEG_OPTIMIZE, 1]
        self._options = jpeg if image_format == "jpg" else []
        self.folder = self.target  # until the context starts

    def __enter__(self) -> RecordingWriter:
        try:
            self.target.parent.mkdir(parents=True, exist_ok=True)
            made = tempfile.mkdtemp(prefix=f".{self.target.name}.", dir=self.target.parent)
            self.folder = Path(made)
            self.folder.chmod(0o755)
            write_cameras(self.cameras, self.folder)
            write_tagslam(self.layout, self.folder / "tagslam.yaml")
            for camera in self.cameras:
                (self.folder / "frames" / camera.name).mkdir(parents=True)
        except OSError as error:
            self._discard()
            raise OutputError(f"cannot write the recording {self.target}: {error.strerror}") from error
        return self

    def write(self, frame: Frame) -> None:
        """Add one frame; safe to call from several threads."""
        name = f"{round(frame.t * 1e9):019d}{self._suffix}"
        _, content = cv2.imencode(self._suffix, frame.image, self._options)
        try:
            (self.folder / "frames" / frame.camera / name).write_bytes(content.tobytes())
        except OSError as error:
            raise OutputError(f"cannot write the recording {self.target}: {error.strerror}") from error

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if kind is not None:
            self._discard()
            return
        old: Path | None = None
        try:
            if self.target.exists():
                old = Path(tempfile.mkdtemp(prefix=f".{self.target.name}.old.", dir=self.target.parent))
                self.target.rename(old / "was")
            self.folder.rename(self.target)
        except OSError as problem:
            if old is not None and (old / "was").exists() and not self.target.exists():
                (old / "was").rename(self.target)
            self._discard()
            raise OutputError(f"cannot write the recording {self.target}: {problem.strerror}") from problem
        finally:
            if old is not None:
                shutil.rmtree(old, ignore_errors=True)

    def _discard(self) -> None:
        if self.folder != self.target:
            shutil.rmtree(self.folder, ignore_errors=True)


def write_recording(
    target: str | Path,
    cameras: Iterable[Camera],
    layout: TagLayout,
    frames: Iterable[Frame],
    *,
    image_format: str = "jpg",
    quality: int = 80,
) -> None:
    """Write a recording from frames as they come; whole or not at all (`RecordingWriter`)."""
    with RecordingWriter(target, cameras, layout, image_format=image_format, quality=quality) as writer:
        for frame in frames:
            writer.write(frame)
