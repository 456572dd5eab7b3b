"""Recordings written as image files, whole or not at all."""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Iterable
from pathlib import Path
from types import TracebackType

import cv2

from tossid.errors import InputError, OutputError
from tossid.types import Frame
from tossid.vision.cameras.camera import Camera
from tossid.vision.setup.calibration import write_cameras
from tossid.vision.setup.layout import TagLayout
from tossid.vision.setup.tagslam import write_tagslam


class RecordingWriter:
    """Writes a recording whole or not at all.

    Use it as a context: frames go to a hidden folder beside the target, which
    takes the target's place when the context ends well, and vanishes otherwise
    (an error, Ctrl-C). Further files (truth) may be put into `folder` meanwhile.

    Raises:
        OutputError: The disk is full, read-only, or not ours to write.
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
        """Prepare to write.

        Args:
            target: The recording's folder. What is there is replaced at the end.
            cameras: Written to its calibration.
            layout: Bodies and tags, written to its calibration.
            image_format: "jpg" or "png".
            quality: Of JPEG, 1 to 100.

        Raises:
            InputError: There is no such format or quality.
        """
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
        """Make the hidden folder, with the calibration in it."""
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
        """Put the folder into its place, or discard it after an error."""
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
