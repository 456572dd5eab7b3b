"""Films: every frame, at its own time, however they are stored and in whatever order they are asked for."""

from __future__ import annotations

import struct
import tracemalloc
from pathlib import Path

import cv2
import numpy as np
import pytest

from tests.vision.recordings.written_films import LATE, SIZE, STEADY, TICK, damage, number_in, numbered, write_film
from tossid import budget
from tossid.errors import FileError
from tossid.settings.limits import ReadLimits
from tossid.vision.recordings.film import FilmDecoder, FilmIndex, index_film


def _numbers(index: FilmIndex, which: list[int] | np.ndarray) -> list[int | None]:
    decoder = FilmDecoder(index, turns=0)
    images = [decoder.image(int(index.pts[i])) for i in which]
    return [None if image is None else number_in(image) for image in images]


@pytest.mark.parametrize("codec", ["libx264", "libx265"])
@pytest.mark.parametrize("kind", list(LATE))
@pytest.mark.parametrize(("b_frames", "suffix"), [(0, ".mp4"), (3, ".mp4"), (3, ".mkv"), (2, ".mov")])
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
def test_avi_has_frames_and_times(tmp_path: Path, codec: str):
    index = index_film(write_film(tmp_path / "a.avi", STEADY, codec=codec))
    np.testing.assert_allclose(np.diff(index.t_ns), 1e9 / 148, atol=1)
    assert _numbers(index, range(60)) == list(range(60))


def test_avi_with_b_frames_is_refused_for_it_has_no_times_of_showing(tmp_path: Path):
    index = index_film(write_film(tmp_path / "a.avi", STEADY, b_frames=3))
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


def test_damaged_frames_are_none_and_the_others_are_right(tmp_path: Path):
    path = write_film(tmp_path / "a.mp4", STEADY)
    damage(path, 24, 36)  # a keyframe, and what hangs on it
    index = index_film(path)
    found = _numbers(index, range(60))
    assert found[:24] == list(range(24))
    assert found[36:] == list(range(36, 60))
    assert found[24:36] == [None] * 12


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
    assert image is not None
    assert image.shape == index.shown[::-1]
    video = cv2.VideoCapture(str(path))
    players = cv2.cvtColor(video.read()[1], cv2.COLOR_BGR2GRAY)
    video.release()
    assert np.abs(image.astype(float) - players).mean() < 2
    unturned = FilmDecoder(index, turns=0).image(0)
    assert unturned is not None
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


@pytest.mark.parametrize("content", [b"", b"no video", b"RIFF\0\0\0\0AVI LIST", b"\x1aE\xdf\xa3"])
def test_what_is_no_film_is_said(tmp_path: Path, content: bytes):
    path = tmp_path / "a.mp4"
    path.write_bytes(content)
    with pytest.raises(FileError, match="not a video"):
        index_film(path)
    with pytest.raises(FileError, match="no such file"):
        index_film(tmp_path / "b.mp4")
