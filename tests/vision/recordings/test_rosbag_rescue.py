"""A bag that breaks off is read as far as it is whole."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from rosbags.rosbag2 import StoragePlugin

from tests.vision.bags import CAMERAS, PICTURES, write_bag
from tossid.errors import FileError
from tossid.objects import ObjectModel
from tossid.vision.recordings.formats.bags import read_bag_detections, read_bag_images
from tossid.vision.setup.calibration import write_cameras
from tossid.vision.setup.layout import layout_of
from tossid.vision.setup.tagslam import write_tagslam


@pytest.mark.parametrize("share", [0.3, 0.7, 0.98])
def test_a_truncated_bag_is_read_as_far_as_it_is_whole_and_reported(tmp_path: Path, share: float):
    path = write_bag(tmp_path, 1)
    whole = path.read_bytes()
    path.write_bytes(whole[: int(share * len(whole))])
    found = read_bag_detections(path, CAMERAS, sigma=1.0)
    assert 0.5 * share * 40 < len(found.detections) <= 40
    assert len(found.detections) == sum(found.n_frames.values())
    (problem,) = found.problems
    assert "breaks off" in problem
    assert "messages are whole" in problem


def _cut(tmp_path: Path, size: int | float, **keys: object) -> Path:
    """An MCAP without its end: a share of its bytes, or all but so many."""
    bag = write_bag(tmp_path, 2, plugin=StoragePlugin.MCAP, **keys)
    (bag / "metadata.yaml").unlink()
    whole = (bag / "bag.mcap").read_bytes()
    (bag / "bag.mcap").write_bytes(whole[: int(size * len(whole)) if isinstance(size, float) else len(whole) - size])
    return bag


@pytest.mark.parametrize("packed", ["", "lz4", "zstd"])
@pytest.mark.parametrize("chunk", [3, 7])
@pytest.mark.parametrize("size", [0.35, 0.6, 0.97, 1, 8, 37, 300])
def test_an_mcap_without_its_end_is_read_as_far_as_it_is_whole(tmp_path: Path, packed: str, chunk: int, size: int):
    bag = _cut(tmp_path, size, packed=packed, chunk=chunk)
    found = read_bag_detections(tmp_path, CAMERAS, sigma=1.0)
    times = {name: [round(d.t, 6) for d in found.detections if d.camera == name] for name in ("left", "right")}
    n = len(times["right"])
    expected = [round(1 + i / 10, 6) for i in range(20)]
    assert times["right"] == expected[:n]  # no message is lost, doubled or out of order
    assert times["left"] in (expected[:n], expected[: n + 1])
    share = size if isinstance(size, float) else 1.0
    assert n >= chunk * int(0.9 * share * 20 / chunk)
    (problem,) = found.problems
    count, words = problem.split("end: ")[1].split(" ", 1)
    assert problem.startswith(f"{bag / 'bag.mcap'} breaks off before its end: ")
    assert 4 * n <= int(count) <= 4 * n + 3  # two topics of either camera
    assert words.startswith("messages are whole, the last of")


def test_a_cut_chunk_gives_the_messages_before_the_cut(tmp_path: Path):
    (tmp_path / "a").mkdir()
    kept = [len(read_bag_detections(_cut(tmp_path / str(share), share), CAMERAS, sigma=1.0).detections)
            for share in (0.2, 0.5, 0.8)]  # fmt: skip
    assert kept == pytest.approx([8, 20, 32], abs=4)  # all frames are in one chunk


@pytest.mark.parametrize("packed", ["", "zstd"])
def test_images_of_a_cut_mcap_are_read(tmp_path: Path, tagged: ObjectModel, packed: str):
    bag = _cut(tmp_path, 0.7, packed=packed, chunk=4)
    write_cameras(CAMERAS, tmp_path)
    write_tagslam(layout_of(tagged), tmp_path / "tagslam.yaml")
    recording = read_bag_images(bag, tmp_path)
    assert "breaks off" in recording.problems[0]
    for files in recording.frames.values():
        assert 12 <= len(files) < 20
        for first in range(0, len(files), 5):
            for i, frame in enumerate(recording.run(files[first : first + 5]), start=first):
                np.testing.assert_allclose(frame.image, PICTURES[i], atol=1)


def test_a_damaged_chunk_ends_an_mcap_without_its_end(tmp_path: Path):
    bag = _cut(tmp_path, 40, packed="zstd", chunk=5)
    content = bytearray((bag / "bag.mcap").read_bytes())
    third = [at for at in range(len(content)) if content[at : at + 4] == b"\x28\xb5\x2f\xfd"][2]
    content[third + 4 : third + 30] = bytes(26)
    (bag / "bag.mcap").write_bytes(content)
    found = read_bag_detections(bag, CAMERAS, sigma=1.0)
    assert found.n_frames == {"left": 10, "right": 10}
    assert "40 messages are whole" in found.problems[0]


@pytest.mark.parametrize("kept", [0, 5, 8, 30, 60])
def test_an_mcap_that_ends_in_its_header_is_no_bag(tmp_path: Path, kept: int):
    bag = _cut(tmp_path, 1)
    path = bag / "bag.mcap"
    path.write_bytes(path.read_bytes()[:kept])
    with pytest.raises(FileError, match="is not a bag that can be read"):
        read_bag_detections(bag, CAMERAS, sigma=1.0)
