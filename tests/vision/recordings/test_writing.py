"""Recordings are written whole or not at all."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tests.vision.recordings.small import CAMERA, small_frames
from tests.vision.written import write_recording
from tossid.errors import InputError, OutputError
from tossid.objects import ObjectModel
from tossid.types import Frame
from tossid.vision.recordings.formats.frames import read_recording
from tossid.vision.recordings.writing import RecordingWriter
from tossid.vision.setup.layout import layout_of


def test_jpeg_is_near(tmp_path: Path, tagged: ObjectModel):
    smooth = np.tile(np.linspace(20, 200, 64), (48, 1)).astype(np.uint8)
    write_recording(tmp_path / "rec", [CAMERA], layout_of(tagged), [Frame("left", 0.0, smooth)], quality=95)
    (frame,) = read_recording(tmp_path / "rec")
    assert np.abs(frame.image.astype(int) - smooth).max() <= 4


@pytest.mark.parametrize("error", [KeyboardInterrupt, RuntimeError])
def test_an_interrupted_recording_leaves_what_was_there(written: Path, tagged: ObjectModel, error: type[BaseException]):
    def interrupted():
        yield small_frames()[0]
        raise error

    with pytest.raises(error):
        write_recording(written, [CAMERA], layout_of(tagged), interrupted())
    assert read_recording(written).n_frames == 4
    assert [path.name for path in written.parent.iterdir()] == ["rec"]


def test_a_finished_recording_replaces_the_old(written: Path, tagged: ObjectModel):
    write_recording(written, [CAMERA], layout_of(tagged), small_frames(2))
    assert read_recording(written).n_frames == 2
    assert [path.name for path in written.parent.iterdir()] == ["rec"]


def test_a_full_disk_is_one_clear_error(tmp_path: Path, tagged: ObjectModel, monkeypatch: pytest.MonkeyPatch):
    def full(self: Path, content: bytes) -> int:
        raise OSError(28, "No space left on device")

    writer = RecordingWriter(tmp_path / "rec", [CAMERA], layout_of(tagged))
    with pytest.raises(OutputError, match="No space left"), writer:
        monkeypatch.setattr(Path, "write_bytes", full)
        writer.write(small_frames()[0])
    assert list(tmp_path.iterdir()) == []


def test_options_are_checked(tmp_path: Path, tagged: ObjectModel):
    with pytest.raises(InputError, match="gif"):
        RecordingWriter(tmp_path / "rec", [CAMERA], layout_of(tagged), image_format="gif")
    with pytest.raises(InputError, match="101"):
        RecordingWriter(tmp_path / "rec", [CAMERA], layout_of(tagged), quality=101)
