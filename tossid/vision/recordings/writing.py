"""Recordings written as JPEG files."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import cv2

from tossid.types import Frame
from tossid.vision.cameras.camera import Camera
from tossid.vision.setup.calibration import write_cameras
from tossid.vision.setup.layout import TagLayout
from tossid.vision.setup.tagslam import write_tagslam


class RecordingWriter:
    """Writes a recording into a folder. `tossid.outputs.output_folder` makes one that appears whole or not at all."""

    def __init__(self, folder: str | Path, cameras: Iterable[Camera], layout: TagLayout, *, quality: int = 80) -> None:
        """Write the calibration.

        Args:
            folder: The recording's; made where there is none.
            cameras: Written to its calibration.
            layout: Bodies and tags, likewise.
            quality: Of JPEG, 1 to 100.
        """
        self.folder, cameras = Path(folder), tuple(cameras)
        self._options = [cv2.IMWRITE_JPEG_QUALITY, quality, cv2.IMWRITE_JPEG_OPTIMIZE, 1]
        for camera in cameras:
            (self.folder / "frames" / camera.name).mkdir(parents=True, exist_ok=True)
        write_cameras(cameras, self.folder)
        write_tagslam(layout, self.folder / "tagslam.yaml")

    def write(self, frame: Frame) -> None:
        """Add one frame; safe to call from several threads."""
        _, content = cv2.imencode(".jpg", frame.image, self._options)
        name = f"{round(frame.t * 1e9):019d}.jpg"
        (self.folder / "frames" / frame.camera / name).write_bytes(content.tobytes())
