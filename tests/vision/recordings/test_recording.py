"""Recordings: whole or not at all, read lazily, and bad frames named."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.vision.recordings.small import CAMERA, small_frames
from tests.vision.written import write_recording
from tossid.errors import FileError
from tossid.objects import ObjectModel
from tossid.vision.cameras.camera import Camera
from tossid.vision.recordings.formats.frames import read_recording
from tossid.vision.setup.calibration import write_cameras
from tossid.vision.setup.layout import layout_of


@pytest.mark.parametrize(
    ("content", "words"),
    [(b"not an image", "not an image"), (b"", "not an image"), (b"\xff\xd8\xff\xe0 cut", "breaks off")],
)
def test_a_frame_that_is_no_image_is_named(written: Path, content: bytes, words: str):
    file = read_recording(written).frames["left"][2]
    file.path.write_bytes(content)
    with pytest.raises(FileError, match=words) as caught:
        list(read_recording(written))
    assert caught.value.path == file.path


@pytest.mark.parametrize("suffix", ["jpg", "png"])
def test_a_truncated_image_is_not_filled_up(tmp_path: Path, tagged: ObjectModel, suffix: str):
    write_recording(tmp_path / "rec", [CAMERA], layout_of(tagged), small_frames(1), image_format=suffix)
    (file,) = read_recording(tmp_path / "rec").frames["left"]
    file.path.write_bytes(file.path.read_bytes()[:-400])
    with pytest.raises(FileError, match="breaks off"):
        read_recording(tmp_path / "rec").read(file)


def test_a_frame_of_another_size_is_named(written: Path, tmp_path: Path, tagged: ObjectModel):
    small = Camera("left", (32, 24), [60, 60, 16, 12])
    write_cameras([small], written)
    with pytest.raises(FileError, match="64 by 48"):
        next(iter(read_recording(written)))
