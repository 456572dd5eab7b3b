"""Frames from videos, and times from names and files."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from tossid.errors import FileError
from tossid.objects import ObjectModel
from tossid.vision.cameras.camera import Camera
from tossid.vision.recordings.formats.videos import read_videos
from tossid.vision.setup.calibration import write_cameras
from tossid.vision.setup.layout import layout_of
from tossid.vision.setup.tagslam import write_tagslam

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
