"""Times of frames, from names and from files."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from tossid.errors import FileError
from tossid.objects import ObjectModel
from tossid.vision.cameras.camera import Camera
from tossid.vision.recordings.formats.frames import read_recording
from tossid.vision.recordings.times import read_times, time_of
from tossid.vision.setup.calibration import write_cameras
from tossid.vision.setup.layout import layout_of
from tossid.vision.setup.tagslam import write_tagslam

SMOOTH = np.tile(np.linspace(20, 120, 64), (48, 1)).astype(np.uint8)


def _frames(folder: Path, tagged: ObjectModel, names: list[str]) -> Path:
    write_cameras([Camera("left", (64, 48), [60, 60, 32, 24])], folder)
    write_tagslam(layout_of(tagged), folder / "tagslam.yaml")
    (folder / "frames" / "left").mkdir(parents=True)
    for name in names:
        cv2.imwrite(str(folder / "frames" / "left" / name), SMOOTH)
    return folder


def _times(folder: Path) -> list[float]:
    return [file.t_ns * 1e-9 for file in read_recording(folder).frames["left"]]


def test_times_come_from_names_in_seconds_or_nanoseconds(tmp_path: Path, tagged: ObjectModel):
    _frames(tmp_path, tagged, ["12.5.png", "0000000013000000000.png", "13.25.png"])
    np.testing.assert_allclose(_times(tmp_path), [12.5, 13.0, 13.25])


@pytest.mark.parametrize("named", [True, False])
def test_times_come_from_a_file_beside_the_frames(tmp_path: Path, tagged: ObjectModel, named: bool):
    names = ["a.png", "b.png", "c.png"]
    folder = _frames(tmp_path, tagged, names)
    stamps = [1403636579763555584, 1403636579813555456, 1403636579863555584]
    lines = [f"{t},{name}" if named else str(t) for t, name in zip(stamps, names, strict=True)]
    file = folder / "frames" / "left" / "data.csv"
    file.write_text("#timestamp [ns],filename\n" + "\n".join(lines))
    np.testing.assert_allclose(_times(folder), np.array(stamps) * 1e-9)
    file.write_text("\n".join(lines[:2]))
    with pytest.raises(FileError, match=r"no time for c\.png" if named else "2 times for 3 images"):
        _times(folder)
    file.write_text("1.0,a.png\nnever,b.png")
    with pytest.raises(FileError, match=r"row 2: 'never,b\.png' is no time"):
        read_times(file)


def test_a_frame_without_a_time_is_named(tmp_path: Path, tagged: ObjectModel):
    with pytest.raises(FileError, match=r"frame_a\.png.*time stamp"):
        _times(_frames(tmp_path, tagged, ["frame_a.png"]))


@pytest.mark.parametrize(("text", "t_ns"), [("12.5", 12_500_000_000), ("5", 5_000_000_000), ("1.5e0", 1_500_000_000), ("1403636579763555584", 1403636579763555584), ("x", None), ("nan", None), ("inf", None)])  # fmt: skip  # noqa: E501
def test_a_time_is_seconds_or_nanoseconds(text: str, t_ns: int | None):
    assert time_of(text) == t_ns
