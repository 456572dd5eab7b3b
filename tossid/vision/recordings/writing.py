"""Recordings written as image files."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import cv2

from tossid.errors import InputError
from tossid.types import Frame
from tossid.vision.cameras.camera import Camera
from tossid.vision.setup.calibration import write_cameras
from tossid.vision.setup.layout import TagLayout
from tossid.vision.setup.tagslam import write_tagslam


class RecordingWriter:
    """Writes a recording into a folder. `tossid.outputs.output_folder` makes one that appears whole or not at all."""

    def __init__(
        self,
        folder: str | Path,
        cameras: Iterable[Camera],
        layout: TagLayout,
        *,
        image_format: str = "jpg",
        quality: int = 80,
    ) -> None:
        """Write the calibration.

        Args:
            folder: The recording's; made where there is none.
            cameras: Written to its calibration.
            layout: Bodies and tags, likewise.
            image_format: "jpg" or "png".
            quality: Of JPEG, 1 to 100.

        Raises:
            InputError: There is no such format or quality.
        """
        if image_format not in ("jpg", "png"):
            raise InputError(f"image format '{image_format}' is not one of jpg, png")
        if not 1 <= quality <= 100:
            raise InputError(f"JPEG quality {quality} is not within 1 to 100")
        self.folder, cameras = Path(folder), tuple(cameras)
        self._suffix = f".{image_format}"
        jpeg = [cv2.IMWRITE_JPEG_QUALITY, quality, cv2.IMWRITE_JPEG_OPTIMIZE, 1]
        self._options = jpeg if image_format == "jpg" else []
        for camera in cameras:
            (self.folder / "frames" / camera.name).mkdir(parents=True, exist_ok=True)
        write_cameras(cameras, self.folder)
        write_tagslam(layout, self.folder / "tagslam.yaml")

    def write(self, frame: Frame) -> None:
        """Add one frame; safe to call from several threads."""
        name = f"{round(frame.t * 1e9):019d}{self._suffix}"
        _, content = cv2.imencode(self._suffix, frame.image, self._options)
        (self.folder / "frames" / frame.camera / name).write_bytes(content.tobytes())
