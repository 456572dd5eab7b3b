"""Files between the stages: they come back as they were, and any other is one clear error."""

from __future__ import annotations

import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from tests.fuzz.targets import TARGETS
from tossid.errors import FileError
from tossid.vision.files import read_detections, read_tracks, write_tracks


def spoilt(name: str, folder: Path, **arrays: np.ndarray) -> Path:
    """A valid file with other arrays in it."""
    path = TARGETS[name].make(folder)
    with np.load(path) as archive:
        data = {key: archive[key] for key in archive.files} | arrays
    np.savez_compressed(path, **data)
    return path


def test_tracks_come_back(tmp_path: Path) -> None:
    (track,) = read_tracks(TARGETS["tracks"].make(tmp_path))
    write_tracks([track, track], tmp_path / "two.npz")
    for again in read_tracks(tmp_path / "two.npz"):
        np.testing.assert_array_equal(again.q, track.q)
        np.testing.assert_array_equal(again.t, track.t)


@pytest.mark.parametrize(
    ("read", "name", "arrays", "says"),
    [
        (read_detections, "detections", {"camera": np.zeros(2)}, "camera holds float64, expected integers"),
        (read_detections, "detections", {"t": np.array(0.5)}, r"t has shape \(\), expected 1 dimension"),
        (read_detections, "detections", {"corners": np.zeros((3, 4, 2))}, "corners has shape"),
        (read_detections, "detections", {"camera": np.array([0, 7])}, "camera indices"),
        (read_tracks, "tracks", {"lengths": np.array([-3, 33])}, "lengths do not fit its times"),
        (read_tracks, "tracks", {"lengths": np.array([2**62, 2**62, 2**62, 2**62 + 30])}, "lengths do not fit"),
        (read_tracks, "tracks", {"q": np.zeros((30, 7), dtype="S8")}, r"q holds \|S8, expected floating-point numbers"),
        (read_tracks, "tracks", {"schema": np.array("tossid.tracks/9")}, "holds tossid.tracks/9"),
    ],
)
def test_arrays_that_do_not_fit_are_one_clear_error(
    read: Callable[[Path], object], name: str, arrays: dict[str, np.ndarray], says: str, tmp_path: Path
) -> None:
    with pytest.raises(FileError, match=says):
        read(spoilt(name, tmp_path, **arrays))


def test_a_file_that_unpacks_to_too_much_is_refused_unread(tmp_path: Path) -> None:
    path = TARGETS["tracks"].make(tmp_path)
    with zipfile.ZipFile(path, "a", zipfile.ZIP_DEFLATED) as archive, archive.open("more.npy", "w") as member:
        for _ in range(40):
            member.write(bytes(1 << 20))
    assert path.stat().st_size < 1 << 17
    with pytest.raises(FileError, match=r"would unpack to 4[0-9]{7} bytes"):
        read_tracks(path)
