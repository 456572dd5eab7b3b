"""Image folders: every frame comes back at its time, read when it is asked for, and what is none is named."""

from __future__ import annotations

import shutil
import tracemalloc
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest

from tests.vision.films import write_recording
from tossid.errors import FileError
from tossid.objects import ObjectModel
from tossid.types import Frame
from tossid.vision.cameras.camera import Camera
from tossid.vision.recordings.formats.frames import read_recording
from tossid.vision.setup.layout import layout_of

CAMERA = Camera("left", (64, 48), [60, 60, 32, 24])
LEFT = Path("frames/left")


def small_frames() -> list[Frame]:
    rng = np.random.default_rng(0)
    return [Frame("left", 0.1 + i / 100, rng.integers(0, 255, (48, 64), dtype=np.uint8)) for i in range(4)]


@pytest.fixture
def written(tmp_path: Path, tagged: ObjectModel) -> Path:
    """A recording of four small frames of noise."""
    write_recording(tmp_path / "rec", [CAMERA], layout_of(tagged), small_frames(), exact=True)
    return tmp_path / "rec"


def first(folder: Path) -> Path:
    return min((folder / LEFT).iterdir())


def renamed(folder: Path, names: list[str]) -> list[float]:
    """Times of the recording with its frames called otherwise [s]."""
    for path, name in zip(sorted((folder / LEFT).iterdir()), names, strict=False):
        path.rename(path.with_name(name))
    for path in (folder / LEFT).iterdir():
        if path.name not in names:
            path.unlink()
    return [file.t_ns * 1e-9 for file in read_recording(folder).frames["left"]]


def test_frames_come_back(written: Path) -> None:
    recording = read_recording(written)
    assert recording.n_frames == 4
    assert recording.rate_hz == pytest.approx(100.0)
    for read, frame in zip(recording, small_frames(), strict=True):
        assert read.t == pytest.approx(frame.t, abs=1e-9)
        np.testing.assert_array_equal(read.image, frame.image)


def test_what_stays_of_a_frame_is_a_name_and_a_time(written: Path) -> None:
    frame = first(written)
    for i in range(5000):
        (written / LEFT / f"{10**9 + 7_000_000 * i:015d}.png").hardlink_to(frame)
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
    assert times[4:6] == [10**9, 10**9 + 7_000_000]


def test_times_come_from_names_or_from_a_file_beside_the_frames(written: Path) -> None:
    seconds = renamed(written, ["0000000012750000000.png", "12.5.png", "13.0.png"])
    np.testing.assert_allclose(seconds, [12.5, 12.75, 13.0])
    names = ["a.png", "b.png", "c.png"]
    stamps = [1403636579763555584, 1403636579813555456, 1403636579863555584]
    table = written / LEFT / "data.csv"
    for lines, missing in (
        ([f"{t},{name}" for t, name in zip(stamps, names, strict=True)], r"no time for c\.png"),
        ([str(t) for t in stamps], "2 times for 3 images"),
    ):
        table.write_text("#timestamp [ns],filename\n" + "\n".join(lines))
        np.testing.assert_allclose(renamed(written, [*names, table.name]), np.array(stamps) * 1e-9)
        table.write_text("\n".join(lines[:2]))
        with pytest.raises(FileError, match=missing):
            read_recording(written)


def _copied(name: str) -> Callable[[Path], object]:
    """The first frame under another name."""
    return lambda folder: shutil.copy(first(folder), folder / LEFT / name)


def _calibrated(old: str, new: str) -> Callable[[Path], object]:
    """With another text in the calibration."""
    return lambda folder: (folder / "cameras.yaml").write_text((folder / "cameras.yaml").read_text().replace(old, new))


def _becomes(content: bytes | int) -> Callable[[Path], object]:
    """The first frame's bytes, or how many of them are cut off."""
    return lambda folder: first(folder).write_bytes(
        first(folder).read_bytes()[:-content] if isinstance(content, int) else content
    )


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (shutil.rmtree, "no such folder"),
        (lambda folder: (folder / LEFT / "notes.txt").write_text("x"), r"notes\.txt"),
        (lambda folder: (folder / "frames" / "right").mkdir(), "right"),
        (lambda folder: [path.unlink() for path in (folder / LEFT).iterdir()], "no frames"),
        (_copied(f"{10**30}.png"), "has the time stamp 10{30} ns, expected at most"),
        (_copied("0.1.png"), "has the same time stamp as"),
        (_copied("notes.doc"), "is neither an image nor a file of times"),
        (_copied("left.png"), "is not named like a frame"),
        (lambda folder: renamed(folder, ["frame_a.png"]), r"frame_a\.png.*time stamp"),
        (lambda folder: renamed(folder, [f"{i:04d}.png" for i in range(4)]),
         r"1e-09 s apart, read in ns.*are the images numbered\?"),
        (_calibrated("left:\n", "left:\n  clock_offset: 1.0e+300\n"), "clock offset"),
        (_calibrated("64", "32"), "64 by 48"),
        (_becomes(b"not an image"), "not an image"),
        (_becomes(b""), "not an image"),
        (_becomes(b"\xff\xd8\xff\xe0 cut"), "breaks off"),
        (_becomes(400), "breaks off"),  # and is not filled up
    ],
)  # fmt: skip
def test_what_is_no_recording_or_no_frame_is_named(written: Path, change: Callable[[Path], object], says: str) -> None:
    with pytest.raises(FileError, match=says):
        change(written)
        list(read_recording(written))


def as_16_bits(written: Path, scale: float, hot: int = 0, dark: int | None = None) -> list[np.ndarray]:
    """The recording as 16-bit PNG, levels scaled, some pixels at the range's end, one frame eight times as dark."""
    grey = []
    for i, path in enumerate(sorted((written / LEFT).iterdir())):
        image = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
        deep = (image * float(scale)).astype(np.uint16) // (8 if i == dark else 1)
        deep.flat[:hot] = 65535
        cv2.imwrite(str(path), deep)
        grey.append(image)
    return grey


@pytest.mark.parametrize(("scale", "hot"), [(256, 0), (16, 0), (4, 0), (1, 0), (16, 40), (257, 40)])
def test_images_of_16_bits_are_scaled_by_the_bits_in_use(written: Path, scale: int, hot: int) -> None:
    grey = as_16_bits(written, scale, hot)
    for frame, image in zip(read_recording(written), grey, strict=True):
        np.testing.assert_array_equal(frame.image.flat[hot:], image.flat[hot:])
        assert (frame.image.flat[:hot] == 255).all()


def test_the_bits_in_use_are_those_of_a_cameras_frames_together(written: Path) -> None:
    """A dark frame stays dark, also where it is the first that is read; 9 bits become 150 of 255, half is used."""
    as_16_bits(written, 300 / 255, dark=1)
    recording = read_recording(written)
    assert recording.read(recording.frames["left"][1]).image.max() < 32
    assert 145 <= max(frame.image.max() for frame in recording) <= 150
