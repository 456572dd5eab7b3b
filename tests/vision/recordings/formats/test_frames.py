"""Image folders: frames come back with their times, and bad ones are named."""

from __future__ import annotations

import tracemalloc
from pathlib import Path

import numpy as np
import pytest

from tests.vision.recordings.small import small_frames
from tossid.errors import FileError
from tossid.vision.recordings.formats.frames import read_recording


def test_frames_come_back(written: Path):
    recording = read_recording(written)
    assert recording.n_frames == 4
    assert recording.rate_hz == pytest.approx(100.0)
    for read, frame in zip(recording, small_frames(), strict=True):
        assert read.t == pytest.approx(frame.t, abs=1e-9)
        np.testing.assert_array_equal(read.image, frame.image)
    assert [file.path.name for file in recording.frames["left"]] == sorted(
        p.name for p in (written / "frames" / "left").iterdir()
    )


def test_folders_that_are_no_recording_are_named(written: Path):
    with pytest.raises(FileError, match="no such folder"):
        read_recording(written / "nowhere")
    (written / "frames" / "left" / "notes.txt").write_text("x")
    with pytest.raises(FileError, match=r"notes\.txt"):
        read_recording(written)
    (written / "frames" / "left" / "notes.txt").unlink()
    (written / "frames" / "right").mkdir()
    with pytest.raises(FileError, match="right"):
        read_recording(written)
    (written / "frames" / "right").rmdir()
    for path in (written / "frames" / "left").iterdir():
        path.unlink()
    with pytest.raises(FileError, match="no frames"):
        read_recording(written)


def test_what_stays_of_a_frame_is_a_name_and_a_time(written: Path):
    folder = written / "frames" / "left"
    first = min(folder.iterdir())
    for i in range(5000):
        (folder / f"{10**9 + 7_000_000 * i:015d}.png").hardlink_to(first)
    kept = []
    for _ in range(3):  # Python's own table of names may have to grow meanwhile, by megabytes
        tracemalloc.start()
        recording = read_recording(written)
        kept.append(tracemalloc.get_traced_memory()[0])
        tracemalloc.stop()
    assert recording.n_frames == 5004
    assert min(kept) < 100 * 5004
    times = [file.t_ns for file in recording.frames["left"]]
    assert times == sorted(times)
    assert [file.t_ns for file in recording.frames["left"][4:6]] == [10**9, 10**9 + 7_000_000]


@pytest.mark.parametrize(
    ("name", "says"),
    [
        (f"{10**30}.png", "has the time stamp 10{30} ns, expected at most"),
        ("0.1.png", "has the same time stamp as"),
        ("notes.doc", "is neither an image nor a file of times"),
        ("left.png", "is not named like a frame"),
    ],
)
def test_a_frame_whose_time_will_not_do_is_named(written: Path, name: str, says: str):
    folder = written / "frames" / "left"
    (folder / name).write_bytes(min(folder.iterdir()).read_bytes())
    with pytest.raises(FileError, match=says):
        read_recording(written)


def test_a_clock_that_is_off_by_ages_is_refused(written: Path):
    text = (written / "cameras.yaml").read_text()
    (written / "cameras.yaml").write_text(text.replace("left:\n", "left:\n  clock_offset: 1.0e+300\n"))
    with pytest.raises(FileError, match="clock offset"):
        read_recording(written)
