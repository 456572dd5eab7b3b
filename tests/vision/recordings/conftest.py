"""A recording of a few small frames of noise, on disk."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.vision.recordings.small import CAMERA, small_frames
from tests.vision.written import write_recording
from tossid.objects import ObjectModel
from tossid.vision.setup.layout import layout_of


@pytest.fixture
def written(tmp_path: Path, tagged: ObjectModel) -> Path:
    write_recording(tmp_path / "rec", [CAMERA], layout_of(tagged), small_frames(), image_format="png")
    return tmp_path / "rec"
