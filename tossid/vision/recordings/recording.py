"""A recording: the frames of some cameras, with their calibration and the layout of the tags."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from tossid import budget
from tossid.errors import FileError
from tossid.types import Frame, OnDemand
from tossid.vision.cameras.camera import Camera
from tossid.vision.recordings.image_decoding import Pixels, grey_pixels
from tossid.vision.recordings.times import LATEST_NS
from tossid.vision.setup.calibration import read_cameras
from tossid.vision.setup.layout import TagLayout
from tossid.vision.setup.tagslam import read_tagslam

LEVEL_FRAMES = 16
"""So many frames of a camera tell how bright its 16-bit images get."""
HOT_PIXELS = 50
"""So many pixels of an image may be brighter than all that it shows; the smallest tag that is found has 64."""
_ENDINGS = {b"\xff\xd8\xff": b"\xff\xd9", b"\x89PNG": b"IEND\xaeB`\x82"}


@dataclass(frozen=True, slots=True)
class FrameFile:
    """Where a frame is.

    Attributes:
        camera: Name of its camera.
        t_ns: Time stamp [ns], corrected for the camera's clock offset.
        path: The image, video or bag.
        index: Time stamp of the frame in a video, in its own unit; time of recording [ns] in a bag.
    """

    camera: str
    t_ns: int
    path: Path
    index: int = 0


class FrameReader(Protocol):
    """Reads the images of a recording."""

    def images(self, files: Sequence[FrameFile]) -> Iterator[Pixels | None]:
        """Grey images (height, width) of 8 or 16 bits of some frames of one camera, in order of time.

        None where a frame is damaged.
        """
        ...


class ImageFiles:
    """Frames that are image files."""

    def images(self, files: Sequence[FrameFile]) -> Iterator[Pixels]:
        """One file a frame."""
        return (read_image(file.path) for file in files)


@dataclass(frozen=True, eq=False)
class Recording:
    """A recording on disk; frames are read when they are asked for.

    Attributes:
        folder: Where its calibration lies.
        cameras: In the order of `cameras.yaml`.
        layout: Bodies and tags of the scene.
        frames: The frames of each camera by name, in order of time.
        reader: Reads their images.
        problems: What could not be read.
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
        frame = next(self.run((file,)), None)
        if frame is None:
            raise FileError(file.path, f"its frame at {file.t_ns * 1e-9:.6f} s is damaged")
        return frame

    def run(self, files: Sequence[FrameFile]) -> Iterator[Frame]:
        """Read frames of one camera, in order of time; those of a film that are damaged are left out.

        Images of 16 bits are scaled to 8 by those that the camera uses.

        Raises:
            FileError: one is missing, no image, cut short, or not of the camera's resolution.
        """
        for file, image in zip(files, self.reader.images(files), strict=True):
            if image is None:
                continue
            width, height = self.camera(file.camera).resolution
            if image.shape != (height, width):
                raise FileError(
                    file.path,
                    f"is {image.shape[1]} by {image.shape[0]} px, but {file.camera} has {width} by {height} px",
                )
            yield Frame(file.camera, file.t_ns * 1e-9, self._in_8_bits(file.camera, image))

    def _in_8_bits(self, camera: str, image: Pixels) -> NDArray[np.uint8]:
        if image.dtype == np.uint8:
            return np.asarray(image, dtype=np.uint8)
        if camera not in self._used_bits:
            self._used_bits[camera] = self._find_used_bits(camera)
        return np.asarray(np.minimum(image >> (self._used_bits[camera] - 8), 255), dtype=np.uint8)

    @cached_property
    def _used_bits(self) -> dict[str, int]:
        """Bits that a camera's 16-bit images use, once they were looked for."""
        return {}

    def _find_used_bits(self, camera: str) -> int:
        """A 10 or 12-bit camera leaves the upper bits empty. One number for all frames, so that none flickers."""
        files = self.frames[camera]
        chosen = np.unique(np.linspace(0, len(files) - 1, LEVEL_FRAMES).astype(int)).tolist()
        images = (next(iter(self.reader.images((files[i],)))) for i in chosen)
        brightest = [
            np.partition(image, -HOT_PIXELS, axis=None)[-HOT_PIXELS:].min() for image in images if image is not None
        ]
        return max(8, int(max(brightest, default=0)).bit_length())

    def __iter__(self) -> Iterator[Frame]:
        """All frames in order of time."""
        files = sorted((file for own in self.frames.values() for file in own), key=lambda file: file.t_ns)
        return (self.read(file) for file in files)


def read_image(path: Path) -> Pixels:
    """A grey image (height, width) of 8 or 16 bits. `FileError` if the file is none, or is cut short."""
    budget.regular_size(path)
    try:
        content = path.read_bytes()
    except OSError as error:
        raise FileError(path, f"cannot be read: {error.strerror}") from error
    for start, end in _ENDINGS.items():
        # OpenCV fills up what is missing of such a file with grey
        if content.startswith(start) and end not in content[-64:]:
            raise FileError(path, "is an image that breaks off before its end")
    image = grey_pixels(path, content)
    if image is None:
        raise FileError(path, "is not an image that can be read")
    return image


def read_set_up(folder: str | Path) -> tuple[tuple[Camera, ...], TagLayout]:
    """The cameras and the tag layout of a folder.

    Raises:
        FileError: what is missing or damaged, by name.
    """
    folder = Path(folder)
    if not folder.is_dir():
        raise FileError(folder, "no such folder; expected a recording (cameras.yaml, tagslam.yaml, frames/)")
    missing = [name for name in ("cameras.yaml", "tagslam.yaml") if not (folder / name).exists()]
    if missing:
        raise FileError(
            folder,
            f"has no {' and no '.join(missing)}; a recording is its images or film with cameras.yaml (calibration), "
            "camera_poses.yaml (where the cameras stand) and tagslam.yaml (the tags' sizes and places)",
        )
    layout = read_tagslam(folder / "tagslam.yaml")
    return read_cameras(folder, layout=layout), layout


def frames_in_order(
    camera: Camera, t_ns: NDArray[np.int64], path: Callable[[int], Path], index: Callable[[int], int] = lambda i: 0
) -> Sequence[FrameFile]:
    """The frames of a camera in order of time. An hour has hundreds of thousands: of each only its time is kept.

    Args:
        camera: The camera; its clock's offset is taken off.
        t_ns: Time stamps of the frames [ns].
        path: Where frame i lies.
        index: Its index there.

    Raises:
        FileError: Two frames have one time stamp, or the clock's offset is beyond all times.
    """
    if abs(camera.clock_offset) * 1e9 > LATEST_NS / 4:
        raise FileError(path(0), f"camera '{camera.name}' has a clock offset of {camera.clock_offset} s")
    own = t_ns - round(camera.clock_offset * 1e9)
    order = np.argsort(own, kind="stable")
    for one, other in itertools.pairwise(order.tolist()):
        if own[one] == own[other]:
            raise FileError(path(other), f"has the same time stamp as {path(one).name}")
    return OnDemand(
        lambda i: FrameFile(camera.name, int(own[order[i]]), path(int(order[i])), index(int(order[i]))),
        len(order),
        kept=0,
    )
