"""Recordings and stages' files where commands look for them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from pipelines.files.open_source import check_stage_name, located, read_track, source_at
from tossid.errors import ConfigError, FileError
from tossid.types import PoseTrack
from tossid.vision.recordings.formats.frames import FramesSource
from tossid.vision.recordings.npz import write_tracks


def test_a_source_without_a_path_is_the_newest_recording(project: Path) -> None:
    (project / "data" / "raw" / "mine").mkdir(parents=True)
    (project / "data" / "raw" / "mine" / "cameras.yaml").touch()
    assert located(FramesSource()).path == Path("data/raw/mine")
    assert located(FramesSource(path=Path("other"))).path == Path("other")


@pytest.mark.parametrize(
    ("inside", "name"),
    [("frames/cam0/1.jpg", "frames"), ("cam0.mp4", "video"), ("film.bag", "rosbag"), (".", "frames")],
)
def test_a_recordings_format_is_known_by_its_files(tmp_path: Path, inside: str, name: str) -> None:
    path = tmp_path / inside
    path.parent.mkdir(parents=True, exist_ok=True)
    if inside != ".":
        path.touch()
    found = source_at(tmp_path)
    assert (found.name, found.path) == (name, tmp_path)


def test_a_stage_takes_the_one_track(tmp_path: Path) -> None:
    q = np.tile([0.0, 0, 0, 1, 0, 0, 0], (3, 1))
    tracks = [PoseTrack(name, np.arange(3.0), q) for name in ("a", "b")]
    write_tracks(tracks[:1], tmp_path / "one.npz")
    write_tracks(tracks, tmp_path / "two.npz")
    assert read_track(tmp_path / "one.npz").name == "a"
    with pytest.raises(FileError, match="holds 2 tracks, expected one"):
        read_track(tmp_path / "two.npz")
    with pytest.raises(FileError, match="'tossid track' makes it"):
        read_track(tmp_path / "none.npz")


def test_a_stages_file_ends_in_npz() -> None:
    assert check_stage_name("out", Path("a.npz")) == Path("a.npz")
    with pytest.raises(ConfigError, match=r"does not end in .npz.*'a.npz'"):
        check_stage_name("out", Path("a.txt"))
