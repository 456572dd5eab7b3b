"""Frames from videos, and times from names and files."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from tossid.errors import FileError
from tossid.objects import ObjectModel
from tossid.vision.calibration import write_cameras
from tossid.vision.camera import Camera
from tossid.vision.film import read_videos
from tossid.vision.layout import layout_of
from tossid.vision.recording import read_recording
from tossid.vision.tagslam import write_tagslam
from tossid.vision.times import read_times, time_of

CAMERA = Camera("left", (64, 48), [60, 60, 32, 24], clock_offset=0.5)
SMOOTH = np.tile(np.linspace(20, 120, 64), (48, 1)).astype(np.uint8)


@pytest.fixture
def videos(tmp_path: Path, tagged: ObjectModel) -> Path:
    """A video of 12 frames, each brighter than the last."""
    write_cameras([CAMERA], tmp_path)
    write_tagslam(layout_of(tagged), tmp_path / "tagslam.yaml")
    writer = cv2.VideoWriter(str(tmp_path / "left.avi"), cv2.VideoWriter_fourcc(*"MJPG"), 25.0, (64, 48))
    for i in range(12):
        writer.write(cv2.cvtColor(SMOOTH + 10 * i, cv2.COLOR_GRAY2BGR))
    writer.release()
    return tmp_path


def test_a_videos_frames_come_by_number(videos: Path):
    recording = read_videos(videos)
    files = recording.frames["left"]
    assert len(files) == 12
    assert recording.rate_hz == pytest.approx(25.0)
    for i, frame in zip(range(4, 9), recording.run(files[4:9]), strict=True):
        assert frame.t == pytest.approx(i / 25 - 0.5)
        assert np.abs(frame.image.astype(int) - (SMOOTH.astype(int) + 10 * i)).mean() < 3


def test_a_videos_times_come_from_a_file_or_a_rate(videos: Path):
    assert read_videos(videos, rate_hz=50.0).rate_hz == pytest.approx(50.0)
    times = 100 + np.arange(12) / 30 + (np.arange(12) > 6) * 0.1  # frames were dropped
    (videos / "left.txt").write_text("# time\n" + "\n".join(f"{t:.6f}" for t in times))
    files = read_videos(videos).frames["left"]
    np.testing.assert_allclose([file.t_ns * 1e-9 for file in files], times - 0.5, atol=1e-6)
    (videos / "left.txt").write_text("1.0\n2.0\n")
    with pytest.raises(FileError, match="2 times for the 12 frames"):
        read_videos(videos)


def test_a_missing_or_broken_video_is_named(videos: Path):
    (videos / "left.avi").write_bytes(b"no video")
    with pytest.raises(FileError, match="not a video"):
        read_videos(videos)
    (videos / "left.avi").unlink()
    with pytest.raises(FileError, match="no video of camera 'left'"):
        read_videos(videos)


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
