"""Detections and tracks between the stages: they come back from files and buffers, and any other file is refused."""

from __future__ import annotations

import zipfile
from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryFile

import numpy as np
import pytest

from tests.fuzz.targets import TARGETS
from tossid.errors import FileError, MotionError
from tossid.types import Detection, PoseTrack
from tossid.vision.recordings import disk_buffer
from tossid.vision.recordings.disk_buffer import DetectionSpool, PoseSpool
from tossid.vision.recordings.npz import read_detections, read_tracks, write_detections, write_tracks


def some_detections() -> list[Detection]:
    rng = np.random.default_rng(0)
    return [
        Detection(f"cam{i % 3}", i / 10, i, rng.normal(size=(4, 2)), rng.normal(size=(4, 2, 2)), i % 2, float(i))
        for i in range(40)
    ]


def some_track(first: int, n: int, *, cov: bool = True) -> PoseTrack:
    rng = np.random.default_rng(first)
    quat = rng.normal(size=(n, 4))
    q = np.hstack([rng.normal(size=(n, 3)), quat / np.linalg.norm(quat, axis=1, keepdims=True)])
    q_cov = np.einsum("nij,nkj->nik", *2 * [rng.normal(size=(n, 6, 6))])
    return PoseTrack("film", (first + np.arange(n)) / 148, q, q_cov if cov else None)


def assert_same(found: object, given: list[Detection]) -> None:
    for mine, theirs in zip(found, given, strict=True):
        for name in ("camera", "t", "tag_id", "hamming", "margin", "corners", "corner_cov"):
            np.testing.assert_array_equal(getattr(mine, name), getattr(theirs, name))


def spoilt(name: str, folder: Path, **arrays: np.ndarray) -> Path:
    """A valid file with other arrays in it."""
    path = TARGETS[name].make(folder)
    with np.load(path) as archive:
        data = {key: archive[key] for key in archive.files} | arrays
    np.savez_compressed(path, **data)
    return path


def test_detections_come_back(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """From a file, from one of the version in which corners shared a covariance, and from a buffer, twice."""
    given, path = some_detections(), tmp_path / "d.npz"
    for rows in (given, []):
        write_detections(rows, path)
        assert_same(read_detections(path), rows)
    write_detections(given, path)
    with np.load(path) as archive:
        old = dict(archive) | {"schema": "tossid.detections/1", "corner_cov": archive["corner_cov"][:, 2]}
    np.savez(path, **old)
    for read, row in zip(read_detections(path), given, strict=True):
        np.testing.assert_array_equal(read.corner_cov, np.tile(row.corner_cov[2], (4, 1, 1)))
    monkeypatch.setattr(disk_buffer, "AT_ONCE", 7)
    with TemporaryFile() as file:
        kept = DetectionSpool(iter(given), file)
        for _ in range(2):
            assert_same(kept, given)


@pytest.mark.parametrize("cov", [True, False])
def test_tracks_come_back(tmp_path: Path, cov: bool) -> None:
    """Two from a file, and stretches from a buffer as one."""
    parts = [some_track(first, n, cov=cov) for first, n in ((0, 10), (10, 5), (20, 8))]
    write_tracks(parts[:2], tmp_path / "two.npz")
    for read, part in zip(read_tracks(tmp_path / "two.npz"), parts[:2], strict=True):
        np.testing.assert_array_equal(read.q, part.q)
        np.testing.assert_array_equal(read.t, part.t)
    with TemporaryFile() as file:
        spool = PoseSpool(file)
        assert spool.track() is None
        for part in parts:
            spool.add(part)
        track = spool.track()
        found = track.frames(slice(7, 18))
        for name in ("q", "t", *["q_cov"] * cov):
            whole = np.concatenate([getattr(part, name) for part in parts])
            np.testing.assert_array_equal(getattr(found, name), whole[7:18])
        assert (found.q_cov is not None) is cov
        for wrong, says in (
            (some_track(5, 10, cov=cov), "does not increase"),
            (some_track(40, 9, cov=not cov), "other"),
        ):
            with pytest.raises(MotionError, match=says):
                spool.add(wrong)


@pytest.mark.parametrize(
    ("name", "arrays", "says"),
    [
        ("detections", {"camera": np.zeros(2)}, "camera holds float64, expected integers"),
        ("detections", {"t": np.array(0.5)}, r"t has shape \(\), expected"),
        ("detections", {"camera": np.array([0, 7])}, "camera indices"),
        ("detections", {"schema": np.array("tossid.tracks/1")}, "expected tossid"),
        ("detections", {"schema": np.array([{"code": 1}], dtype=object)}, "npz"),  # it is not unpickled
        ("tracks", {"lengths": np.array([2**62] * 3 + [2**62 + 30]), "names": np.array(list("abcd"))}, "do not fit"),
        ("tracks", {"q": np.zeros((30, 7), dtype="S8")}, r"q holds \|S8, expected floating-point numbers"),
        ("tracks", {"schema": np.array("tossid.tracks/9")}, "holds tossid.tracks/9"),
    ],
)
def test_arrays_that_do_not_fit_are_one_clear_error(
    name: str, arrays: dict[str, np.ndarray], says: str, tmp_path: Path
) -> None:
    read: Callable[[Path], object] = read_detections if name == "detections" else read_tracks
    with pytest.raises(FileError, match=says):
        read(spoilt(name, tmp_path, **arrays))


def test_a_file_that_unpacks_to_too_much_is_refused_unread(tmp_path: Path) -> None:
    path = TARGETS["tracks"].make(tmp_path)
    with zipfile.ZipFile(path, "a", zipfile.ZIP_DEFLATED) as archive, archive.open("more.npy", "w") as member:
        for _ in range(80):
            member.write(bytes(1 << 20))
    assert path.stat().st_size < 1 << 18
    with pytest.raises(FileError, match=r"claims 8[0-9,]{9} bytes when unpacked"):
        read_tracks(path)
