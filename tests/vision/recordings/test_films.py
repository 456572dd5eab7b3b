"""Films: every frame at its own time, whose times hold, which way up images are, and what is said."""

from __future__ import annotations

import struct
import tracemalloc
from collections.abc import Sequence
from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import av
import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from tossid import budget
from tossid.errors import FileError, InputError
from tossid.ingestion import stages
from tossid.ingestion.progress import Reporter
from tossid.objects import ObjectModel
from tossid.settings.limits import ReadLimits
from tossid.vision.cameras.camera import Camera
from tossid.vision.recordings.film import FilmDecoder, FilmIndex, index_film
from tossid.vision.recordings.formats.videos import VideoSource, read_videos
from tossid.vision.recordings.registry import open_recording
from tossid.vision.setup.calibration import write_cameras
from tossid.vision.setup.layout import layout_of
from tossid.vision.setup.tagslam import write_tagslam

SIZE = (96, 64)
"""Width and height [px]."""
BITS = 7
RATE = 148
TICK = Fraction(1, RATE * 100)
"""Unit of time [s] in which `write_film` takes times; a container may round it."""


def numbered(number: int) -> NDArray[np.uint8]:
    """An image with the bits of a number as bright and dark bars, over noise."""
    width, height = SIZE
    image = np.random.default_rng(number).integers(60, 120, (height, width), dtype=np.uint8)
    for bit in range(BITS):
        image[8:40, 4 + 13 * bit : 14 + 13 * bit] = 235 if number >> bit & 1 else 20
    return image


def number_in(image: NDArray[np.uint8]) -> int:
    """The number that an image shows."""
    bars = [float(image[12:36, 6 + 13 * bit : 12 + 13 * bit].mean()) for bit in range(BITS)]
    return sum((bar > 128) << bit for bit, bar in enumerate(bars))


def write_film(
    path: Path,
    ticks: Sequence[int] | NDArray[np.int64],
    *,
    codec: str = "libx264",
    b_frames: int = 0,
    turned: int = 0,
) -> Path:
    """Write frames 0, 1, 2... at times in units of `TICK`, which players turn by so many degrees counterclockwise."""
    options = {"crf": "12", "preset": "ultrafast"}
    if codec == "libx265":
        options["x265-params"] = f"log-level=none:bframes={b_frames}:keyint=12"
    with av.open(str(path), "w") as container:
        stream = container.add_stream(codec, rate=RATE, options=options if codec.startswith("libx26") else {})
        stream.width, stream.height = SIZE
        stream.pix_fmt = "gray" if codec == "ffv1" else "yuvj420p" if codec == "mjpeg" else "yuv420p"
        stream.codec_context.time_base = Fraction(1, RATE) if path.suffix == ".avi" else TICK
        stream.gop_size, stream.max_b_frames = 12, b_frames
        if turned:
            stream.set_display_rotation(turned)
        for number, at in enumerate(ticks):
            frame = av.VideoFrame.from_ndarray(numbered(number), "gray").reformat(format=stream.pix_fmt)
            frame.pts, frame.time_base = int(at), TICK
            container.mux(stream.encode(frame))
        container.mux(stream.encode())
    return path


def damage(path: Path, first: int, last: int) -> None:
    """Overwrite the packets of some frames of a film without B-frames with zeros."""
    with av.open(str(path)) as container:
        places = [(packet.pos, packet.size) for packet in container.demux(video=0) if packet.size]
    content = bytearray(path.read_bytes())
    for at, size in places[first:last]:
        content[at : at + size] = bytes(size)
    path.write_bytes(content)


STEADY = np.arange(60) * 100
LATE = {
    "constant": STEADY,
    "dropped": np.delete(np.arange(68), [9, 10, 11, 30, 31, 47, 50, 66]) * 100,
    "variable": np.concatenate([STEADY[:20], 2000 + 2 * STEADY[:20], 6000 + STEADY[:20]]),
    "jittered": STEADY + np.random.default_rng(1).integers(0, 60, 60) * (STEADY > 0),
    "offset": STEADY + 7_400,
}
"""When the frames of films of each kind are shown, in units of `TICK`."""


def _numbers(index: FilmIndex, which: list[int] | np.ndarray) -> list[int | None]:
    decoder = FilmDecoder(index, turns=0)
    images = [decoder.image(int(index.pts[i])) for i in which]
    return [None if image is None else number_in(image) for image in images]


@pytest.mark.parametrize("kind", list(LATE))
@pytest.mark.parametrize(
    ("codec", "b_frames", "suffix"), [("libx264", 0, ".mp4"), ("libx265", 3, ".mkv"), ("libx264", 2, ".mov")]
)
def test_each_frame_has_its_time(tmp_path: Path, codec: str, kind: str, b_frames: int, suffix: str):
    ticks = LATE[kind]
    index = index_film(write_film(tmp_path / f"a{suffix}", ticks, codec=codec, b_frames=b_frames))
    rounded = 0.5e-3 if suffix == ".mkv" else 1e-9  # Matroska counts milliseconds
    np.testing.assert_allclose(np.array(index.t_ns) * 1e-9, ticks * float(TICK), atol=rounded + 1e-9)
    in_order = list(range(len(ticks)))
    assert _numbers(index, in_order) == in_order
    mixed = np.random.default_rng(0).permutation(len(ticks))[:15]
    assert _numbers(index, mixed) == mixed.tolist()


@pytest.mark.parametrize("codec", ["mjpeg", "ffv1", "mpeg4"])
def test_avi_has_frames_and_times_but_for_b_frames(tmp_path: Path, codec: str):
    index = index_film(write_film(tmp_path / "a.avi", STEADY, codec=codec))
    np.testing.assert_allclose(np.diff(index.t_ns), 1e9 / 148, atol=1)
    assert _numbers(index, range(60)) == list(range(60))
    index = index_film(write_film(tmp_path / "b.avi", STEADY, b_frames=3))
    with pytest.raises(FileError, match=r"times that do not go with its frames \(B-frames in AVI"):
        _numbers(index, range(60))


def test_what_an_edit_list_hides_is_no_frame(tmp_path: Path):
    path = write_film(tmp_path / "a.mp4", STEADY, b_frames=2)
    content = bytearray(path.read_bytes())
    at = content.index(b"elst") + 12
    length, start = struct.unpack_from(">Ii", content, at)
    struct.pack_into(">Ii", content, at, length, start + 1700)  # begins with frame 17, behind a keyframe
    path.write_bytes(content)
    index = index_film(path)
    np.testing.assert_allclose(index.t_ns, (STEADY[17:] - 1700) * float(TICK) * 1e9, atol=1)
    assert _numbers(index, range(len(index.pts))) == list(range(17, 60))


def test_a_cut_film_has_the_frames_before_the_cut(tmp_path: Path):
    for share in (0.4, 0.7, 0.95):
        path = write_film(tmp_path / "a.mkv", STEADY, b_frames=2)
        content = path.read_bytes()
        path.write_bytes(content[: int(share * len(content))])
        index = index_film(path)
        found = _numbers(index, range(len(index.pts)))
        assert 0.5 * share * 60 < len(found) < 60
        shown = np.round(np.array(index.t_ns) * 148e-9).astype(int).tolist()
        assert all(number in (i, None) for i, number in zip(shown, found, strict=True))
        assert found.count(None) <= 3


def test_a_header_that_claims_other_frames_is_not_believed(tmp_path: Path):
    path = write_film(tmp_path / "a.avi", STEADY, codec="mjpeg")
    content = bytearray(path.read_bytes())
    for name, offset in ((b"avih", 8 + 16), (b"strh", 8 + 32)):
        at = content.index(name) + offset
        content[at : at + 4] = struct.pack("<I", 2_000_000_000)
    path.write_bytes(content)
    assert len(index_film(path).pts) == 60


@pytest.mark.parametrize("degrees", [0, 90, 180, 270])
def test_images_are_turned_as_players_turn_them(tmp_path: Path, degrees: int):
    path = write_film(tmp_path / "a.mp4", STEADY[:3], turned=degrees)
    index = index_film(path)
    assert index.size == SIZE
    image = FilmDecoder(index, turns=index.turns).image(0)
    assert image.shape == index.shown[::-1]
    video = cv2.VideoCapture(str(path))
    players = cv2.cvtColor(video.read()[1], cv2.COLOR_BGR2GRAY)
    video.release()
    assert np.abs(image.astype(float) - players).mean() < 2
    unturned = FilmDecoder(index, turns=0).image(0)
    assert np.abs(unturned.astype(float) - numbered(0)).mean() < 8


def test_memory_does_not_grow_with_a_film(tmp_path: Path):
    kept = []
    for n in (40, 120):
        index = index_film(write_film(tmp_path / "a.mp4", np.arange(n) * 100))
        tracemalloc.start()
        decoder = FilmDecoder(index, turns=0)
        for pts in index.pts:
            decoder.image(int(pts))
        kept.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
    assert kept[1] < kept[0] + 3 * SIZE[0] * SIZE[1]


def test_a_frame_of_too_many_pixels_is_refused(tmp_path: Path):
    path = write_film(tmp_path / "a.mp4", STEADY[:3])
    budget.use_limits(ReadLimits(pixels=1000))
    try:
        with pytest.raises(FileError, match="without frames that can be decoded"):
            index_film(path)
    finally:
        budget.use_limits(ReadLimits())


@pytest.fixture
def folder(tmp_path: Path, tagged: ObjectModel) -> Path:
    """A recording without films."""
    _calibrated(tmp_path)
    write_tagslam(layout_of(tagged), tmp_path / "tagslam.yaml")
    return tmp_path


def _calibrated(folder: Path, *, size: tuple[int, int] = SIZE, rate_hz: float | None = None) -> None:
    write_cameras([Camera("left", size, [60, 60, 32, 24], clock_offset=0.5, rate_hz=rate_hz)], folder)


def _times(folder: Path, **keys: float) -> np.ndarray:
    return np.array([file.t_ns for file in read_videos(folder, **keys).frames["left"]]) * 1e-9 + 0.5


@pytest.mark.parametrize("kind", ["dropped", "variable", "offset"])
def test_times_that_a_container_rounds_to_milliseconds_are_put_back_on_their_grid(folder: Path, kind: str):
    write_film(folder / "left.mkv", LATE[kind])
    off = _times(folder) - LATE[kind] * float(TICK)
    assert np.ptp(off) < 0.2e-3  # rounded, it is 1 ms
    assert abs(off.mean()) < 0.25e-3


def test_batches_of_frames_are_read_in_any_order(folder: Path):
    write_film(folder / "left.mp4", LATE["dropped"], b_frames=3)
    recording = read_videos(folder)
    files = recording.frames["left"]
    assert recording.n_frames == 60
    at_once = [recording.run(files[first : first + 20]) for first in (20, 0, 40)]  # as threads would
    found = [[number_in(frame.image) for frame in run] for run in at_once]
    assert found == [list(range(20, 40)), list(range(20)), list(range(40, 60))]
    assert number_in(recording.read(files[7]).image) == 7
    assert recording.read(files[7]).t == pytest.approx(LATE["dropped"][7] * float(TICK) - 0.5)


def test_exact_times_beside_a_film_hold_where_their_number_is_that_of_its_frames(folder: Path):
    write_film(folder / "left.mkv", LATE["offset"])  # the header has no count; a guess from its length is 109
    times = 100 + np.cumsum(np.random.default_rng(0).uniform(0.006, 0.008, 60))
    (folder / "left.txt").write_text("# time\n" + "\n".join(f"{t:.6f}" for t in times))
    np.testing.assert_allclose(_times(folder), times, atol=1e-6)
    (folder / "left.txt").write_text("1.0\n2.0\n")
    with pytest.raises(FileError, match=r"has 2 times for the 60 frames of left\.mkv"):
        read_videos(folder)


def test_a_rate_that_is_not_the_films_is_said_and_does_not_hold(folder: Path):
    write_film(folder / "left.mp4", STEADY)
    _calibrated(folder, rate_hz=240.0)
    found = read_videos(folder)
    assert found.rate_hz == pytest.approx(148, rel=1e-6)
    (problem,) = found.problems
    assert "cameras.yaml says 240 Hz for left, but the times of the video say 148 Hz; these hold" in problem
    _calibrated(folder, rate_hz=147.0)
    assert read_videos(folder).problems == ()


def test_a_slow_motion_film_is_stretched_to_the_rate_that_is_given(folder: Path):
    played = 8  # taken at eight times the rate at which it plays, with frames dropped
    write_film(folder / "left.mp4", LATE["dropped"] * played)
    times = _times(folder, rate_hz=148.0)
    np.testing.assert_allclose(times, LATE["dropped"] * float(TICK), atol=1e-8)
    (problem,) = read_videos(folder, rate_hz=148.0).problems
    assert "plays at 18.5 Hz; its times are stretched to source.rate_hz=148" in problem


@pytest.mark.parametrize("degrees", [90, 180, 270])
def test_a_turned_film_goes_with_the_calibration_of_its_size(folder: Path, degrees: int):
    write_film(folder / "left.mp4", STEADY, turned=degrees)
    sideways = degrees % 180 != 0
    _calibrated(folder, size=SIZE[::-1] if sideways else SIZE)
    recording = read_videos(folder)
    assert recording.read(recording.frames["left"][3]).image.shape == (SIZE if sideways else SIZE[::-1])
    assert f"turned by {degrees}° as its metadata say" in recording.problems[0]
    if sideways:
        _calibrated(folder, size=SIZE)
        recording = read_videos(folder)
        assert number_in(recording.read(recording.frames["left"][3]).image) == 3
        assert "left as they are stored, as left was calibrated" in recording.problems[0]


def test_a_missing_film_or_one_of_another_size_is_named(folder: Path):
    with pytest.raises(FileError, match="no video of camera 'left'"):
        read_videos(folder)
    for content in (b"", b"no video", b"RIFF\0\0\0\0AVI LIST", b"\x1aE\xdf\xa3"):
        (folder / "left.mp4").write_bytes(content)
        with pytest.raises(FileError, match="not a video"):
            read_videos(folder)
    write_film(folder / "left.mp4", STEADY[:3])
    _calibrated(folder, size=(1920, 1080))
    with pytest.raises(FileError, match="is 96 by 64 px, but left has 1920 by 1080 px"):
        read_videos(folder)


def test_damaged_frames_are_counted_and_left_out(folder: Path, tagged: ObjectModel, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(stages, "usual_cause", lambda *_, **__: None)  # why no tag is seen is not the question
    damage(write_film(folder / "left.mp4", STEADY), 24, 36)
    recording = read_videos(folder)
    assert [number_in(frame.image) for frame in recording.run(recording.frames["left"][20:40])] == [
        *range(20, 24),
        *range(36, 40),
    ]
    with pytest.raises(FileError, match=r"its frame at -0\.3\d+ s is damaged"):
        recording.read(recording.frames["left"][25])
    opened = replace(open_recording(VideoSource(path=folder)), model=tagged)
    report = Reporter(lambda progress: None)
    with pytest.raises(InputError, match="no tag was seen"):
        list(stages.detect(opened, report=report))
    assert f"{folder}: 12 of 60 frames are damaged and left out" in report.problems
