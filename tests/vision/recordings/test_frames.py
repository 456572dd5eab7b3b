"""Image folders: read lazily, and bad frames named."""

from __future__ import annotations

import tracemalloc
from pathlib import Path

import cv2
import numpy as np
import pytest

from tests.vision.recordings.small import CAMERA, small_frames
from tests.vision.written import write_recording
from tossid.errors import FileError, InputError
from tossid.objects import ObjectModel
from tossid.types import Frame
from tossid.vision.cameras.camera import Camera
from tossid.vision.recordings.formats.frames import read_recording
from tossid.vision.recordings.writing import RecordingWriter
from tossid.vision.setup.calibration import write_cameras
from tossid.vision.setup.layout import layout_of


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


def as_16_bits(written: Path, scale: float, hot: int = 0) -> list[np.ndarray]:
    """The recording with its frames as 16-bit PNG, their levels scaled, some pixels at the end of the range."""
    grey = []
    for file in read_recording(written).frames["left"]:
        image = cv2.imread(str(file.path), cv2.IMREAD_GRAYSCALE)
        file.path.unlink()
        deep = (image * float(scale)).astype(np.uint16)
        deep.flat[:hot] = 65535
        cv2.imwrite(str(file.path.with_suffix(".png")), deep)
        grey.append(image)
    return grey


@pytest.mark.parametrize(("scale", "hot"), [(256, 0), (16, 0), (4, 0), (1, 0), (16, 40), (257, 40)])
def test_images_of_16_bits_are_scaled_by_the_bits_in_use(written: Path, scale: int, hot: int):
    grey = as_16_bits(written, scale, hot)
    for frame, image in zip(read_recording(written), grey, strict=True):
        np.testing.assert_array_equal(frame.image.flat[hot:], image.flat[hot:])
        assert (frame.image.flat[:hot] == 255).all()


def test_a_dark_frame_stays_dark_among_the_others_of_its_camera(written: Path):
    files = read_recording(written).frames["left"]
    as_16_bits(written, 16)
    dark = files[1].path.with_suffix(".png")
    cv2.imwrite(str(dark), cv2.imread(str(dark), cv2.IMREAD_UNCHANGED) // 8)
    recording = read_recording(written)
    only = recording.read(recording.frames["left"][1]).image  # also where it is the first that is read
    assert only.max() < 32
    assert next(iter(recording)).image.max() > 250


def test_the_bits_in_use_are_those_of_each_camera(written: Path):
    """Levels of 300 are 9 bits: they become 150 of 255, a half is always used."""
    as_16_bits(written, 300 / 255)
    assert 145 <= max(frame.image.max() for frame in read_recording(written)) <= 150


def test_a_frame_of_another_size_is_named(written: Path, tmp_path: Path, tagged: ObjectModel):
    small = Camera("left", (32, 24), [60, 60, 16, 12])
    write_cameras([small], written)
    with pytest.raises(FileError, match="64 by 48"):
        next(iter(read_recording(written)))


def test_jpeg_is_near(tmp_path: Path, tagged: ObjectModel):
    smooth = np.tile(np.linspace(20, 200, 64), (48, 1)).astype(np.uint8)
    write_recording(tmp_path / "rec", [CAMERA], layout_of(tagged), [Frame("left", 0.0, smooth)], quality=95)
    (frame,) = read_recording(tmp_path / "rec")
    assert np.abs(frame.image.astype(int) - smooth).max() <= 4


def test_options_are_checked(tmp_path: Path, tagged: ObjectModel):
    with pytest.raises(InputError, match="gif"):
        RecordingWriter(tmp_path / "rec", [CAMERA], layout_of(tagged), image_format="gif")
    with pytest.raises(InputError, match="101"):
        RecordingWriter(tmp_path / "rec", [CAMERA], layout_of(tagged), quality=101)
