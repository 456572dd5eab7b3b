"""Files between the stages: they come back as they were, and any other is one clear error."""

from __future__ import annotations

import signal
import subprocess
import sys
import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from tests.fuzz.targets import TARGETS
from tests.vision.conftest import Filmed
from tossid.errors import FileError
from tossid.objects import ObjectModel
from tossid.outputs import output_file
from tossid.vision.detection.detect import TagFinder
from tossid.vision.recordings.npz import read_detections, read_tracks, write_detections, write_tracks


def spoilt(name: str, folder: Path, **arrays: np.ndarray) -> Path:
    """A valid file with other arrays in it."""
    path = TARGETS[name].make(folder)
    with np.load(path) as archive:
        data = {key: archive[key] for key in archive.files} | arrays
    np.savez_compressed(path, **data)
    return path


KILLED = """
import os, signal, sys
import numpy as np
def half(stream, **arrays):
    stream.write(b"half of a file")
    stream.flush()
    os.kill(os.getpid(), signal.SIGKILL)
np.savez_compressed = half
from pathlib import Path
from tossid.outputs import output_file
from tossid.vision.recordings.npz import write_detections
with output_file(Path(sys.argv[1])) as temporary:
    write_detections([], temporary)
"""


def test_what_a_killed_writer_leaves_the_next_one_removes(tmp_path: Path) -> None:
    """Written as a stage does: a temporary of the command's, filled by the writer."""
    path = tmp_path / "found.npz"
    assert subprocess.run([sys.executable, "-c", KILLED, str(path)], timeout=60).returncode == -signal.SIGKILL
    assert any(entry.read_bytes() == b"half of a file" for entry in tmp_path.iterdir())
    with output_file(path) as temporary:
        write_detections([], temporary)
    assert list(tmp_path.iterdir()) == [path]
    assert read_detections(path) == ()


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
        (read_detections, "detections", {"t": np.array(0.5)}, r"t has shape \(\), expected"),
        (read_detections, "detections", {"corners": np.zeros((3, 4, 2))}, "corners has shape"),
        (read_detections, "detections", {"camera": np.array([0, 7])}, "camera indices"),
        (
            read_tracks,
            "tracks",
            {"lengths": np.array([-3, 33]), "names": np.array(["a", "b"])},
            "lengths do not fit its times",
        ),
        (
            read_tracks,
            "tracks",
            {"lengths": np.array([2**62] * 3 + [2**62 + 30]), "names": np.array(list("abcd"))},
            "lengths do not fit",
        ),
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
        for _ in range(80):
            member.write(bytes(1 << 20))
    assert path.stat().st_size < 1 << 18
    with pytest.raises(FileError, match=r"claims 8[0-9,]{9} bytes when unpacked"):
        read_tracks(path)


def test_detections_come_back_from_their_file(filmed: Filmed, tagged: ObjectModel, tmp_path: Path):
    finder = TagFinder(filmed.recording.cameras[0], tagged)
    rows = [d for file in filmed.recording.frames["cam0"][:8] for d in finder.find(filmed.recording.read(file))]
    assert rows
    write_detections(rows, tmp_path / "d.npz")
    for read, row in zip(read_detections(tmp_path / "d.npz"), rows, strict=True):
        assert (read.camera, read.t, read.tag_id, read.hamming, read.margin) == (
            row.camera,
            row.t,
            row.tag_id,
            row.hamming,
            row.margin,
        )
        np.testing.assert_array_equal(read.corners, row.corners)
        np.testing.assert_array_equal(read.corner_cov, row.corner_cov)
    with np.load(tmp_path / "d.npz") as archive:  # as it was when four corners shared one covariance
        old = dict(archive) | {"schema": "tossid.detections/1", "corner_cov": archive["corner_cov"][:, 2]}
    np.savez(tmp_path / "old.npz", **old)
    for read, row in zip(read_detections(tmp_path / "old.npz"), rows, strict=True):
        np.testing.assert_array_equal(read.corner_cov, np.tile(row.corner_cov[2], (4, 1, 1)))
    write_detections([], tmp_path / "none.npz")
    assert read_detections(tmp_path / "none.npz") == ()


def test_a_damaged_file_of_detections_is_named(tmp_path: Path):
    write_detections([], tmp_path / "d.npz")
    content = (tmp_path / "d.npz").read_bytes()
    for damaged in (b"", b"text", content[: len(content) // 2]):
        (tmp_path / "d.npz").write_bytes(damaged)
        with pytest.raises(FileError, match=r"d\.npz"):
            read_detections(tmp_path / "d.npz")
    np.savez(tmp_path / "other.npz", schema=np.array("tossid.tracks/1"))
    with pytest.raises(FileError, match="expected tossid"):
        read_detections(tmp_path / "other.npz")
    np.savez(tmp_path / "pickle.npz", schema=np.array([{"code": 1}], dtype=object))
    with pytest.raises(FileError):
        read_detections(tmp_path / "pickle.npz")
