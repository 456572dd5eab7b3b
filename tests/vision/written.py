"""Recordings from frames."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from tossid.types import Frame
from tossid.vision.cameras.camera import Camera
from tossid.vision.recordings.writing import RecordingWriter
from tossid.vision.setup.layout import TagLayout


def write_recording(
    target: str | Path,
    cameras: Iterable[Camera],
    layout: TagLayout,
    frames: Iterable[Frame],
    *,
    image_format: str = "jpg",
    quality: int = 80,
) -> None:
    """Write a recording from frames as they come."""
    writer = RecordingWriter(target, cameras, layout, image_format=image_format, quality=quality)
    for frame in frames:
        writer.write(frame)
