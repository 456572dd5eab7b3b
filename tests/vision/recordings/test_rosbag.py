"""Bags: what was written comes back, of both ROS versions, packed or plain; and damage is said."""

from __future__ import annotations

import bz2
import sqlite3
from pathlib import Path

import numpy as np
import pytest
from rosbags.rosbag2 import CompressionMode, StoragePlugin

from tests.vision.bags import CAMERAS, PICTURES, STORES, header, write_bag
from tossid.errors import FileError, InputError
from tossid.objects import ObjectModel
from tossid.vision.recordings.formats.bags import read_bag_detections, read_bag_images
from tossid.vision.recordings.registry import format_named, recognized_format
from tossid.vision.recordings.rosbag import grey_image
from tossid.vision.setup.calibration import write_cameras
from tossid.vision.setup.layout import layout_of
from tossid.vision.setup.tagslam import write_tagslam


def test_a_packed_bag_is_unpacked(tmp_path: Path):
    plain = write_bag(tmp_path, 1)
    packed = tmp_path / "packed" / "b.bag.bz2"
    packed.parent.mkdir()
    packed.write_bytes(bz2.compress(plain.read_bytes()))
    assert len(read_bag_detections(packed.parent, CAMERAS, sigma=1.0).detections) == 40


def test_a_cut_database_is_an_error(tmp_path: Path):
    path = write_bag(tmp_path, 2)
    (data,) = [file for file in path.iterdir() if file.suffix == ".db3"]
    whole = data.read_bytes()
    data.write_bytes(whole[: len(whole) // 2])
    with pytest.raises(FileError, match=r"damaged|cannot|can be read"):
        read_bag_detections(path, CAMERAS, sigma=1.0)


def test_what_is_no_bag_is_said(tmp_path: Path):
    for name, content in (("a.bag", b"nonsense"), ("b.mcap", b""), ("c.bag", b""), ("d.bag.bz2", b"no")):
        (tmp_path / name).write_bytes(content)
        with pytest.raises(FileError, match=r"can be read|unpacked") as caught:
            read_bag_detections(tmp_path / name, CAMERAS, sigma=1.0)
        assert caught.value.path == tmp_path / name
    with pytest.raises(FileError, match="no such bag"):
        read_bag_detections(tmp_path / "none", CAMERAS, sigma=1.0)
    (tmp_path / "empty").mkdir()
    with pytest.raises(FileError, match="holds no bag"):
        read_bag_detections(tmp_path / "empty", CAMERAS, sigma=1.0)


def _tags(path: Path) -> tuple[list[float], tuple[str, ...]]:
    """Times of the left camera's detections, and the problems."""
    found = read_bag_detections(path, CAMERAS, sigma=1.0)
    return [round(d.t, 6) for d in found.detections if d.camera == "left"], found.problems


ALL = [round(1 + i / 10, 6) for i in range(20)]


@pytest.mark.parametrize("plugin", list(StoragePlugin))
@pytest.mark.parametrize("above", [True, False])
def test_a_bag_without_metadata_is_found(tmp_path: Path, plugin: StoragePlugin, above: bool):
    bag = write_bag(tmp_path / "recording", 2, plugin=plugin)
    (bag / "metadata.yaml").unlink()
    times, problems = _tags(bag.parent if above else bag)
    assert times == ALL
    said = f"{bag} has no metadata.yaml: 80 messages are whole, the last of 3.150 s"
    assert problems == ((said,) if plugin is StoragePlugin.SQLITE3 else ())  # an MCAP's end says that it is whole
    assert recognized_format(bag.parent if above else bag) is format_named("rosbag")


@pytest.mark.parametrize("plugin", list(StoragePlugin))
@pytest.mark.parametrize("metadata", [None, "", "rosbag2_bagfile_information: {version: 9", "stale"])
def test_the_parts_of_a_bag_without_metadata_are_one_bag(
    tmp_path: Path, tagged: ObjectModel, plugin: StoragePlugin, metadata: str | None
):
    folder = tmp_path / "killed"
    for number, frames in ((2, range(4)), (10, range(4, 20))):
        bag = write_bag(tmp_path / str(number), 2, plugin=plugin, frames=frames)
        (part,) = bag.glob("bag.*")
        folder.mkdir(exist_ok=True)
        part.rename(folder / f"bag_{number}{part.suffix}")
    if metadata is not None:
        text = (bag / "metadata.yaml").read_text().replace("bag.", "bag_2.") if metadata == "stale" else metadata
        (folder / "metadata.yaml").write_text(text)
    assert _tags(tmp_path / "killed")[0] == ALL
    write_cameras(CAMERAS, tmp_path)
    write_tagslam(layout_of(tagged), tmp_path / "tagslam.yaml")
    recording = read_bag_images(folder)
    assert recording.n_frames == 40
    for i, frame in enumerate(recording.run(recording.frames["right"][2:7]), start=2):
        np.testing.assert_array_equal(frame.image, PICTURES[i])


@pytest.mark.parametrize("mode", [CompressionMode.MESSAGE, CompressionMode.FILE])
def test_compression_that_missing_metadata_would_name_is_seen(tmp_path: Path, mode: CompressionMode):
    bag = write_bag(tmp_path, 2, compression=mode)
    (bag / "metadata.yaml").unlink()
    assert _tags(tmp_path)[0] == ALL


@pytest.mark.parametrize("journal", ["WAL", "DELETE"])
def test_what_a_killed_recorder_left_beside_its_database_counts(tmp_path: Path, journal: str):
    """A log of what was written holds, a journal takes back what was not."""
    bag, killed = write_bag(tmp_path / "a", 2), tmp_path / "killed"
    killed.mkdir()
    database = sqlite3.connect(bag / "bag.db3")
    database.execute(f"PRAGMA journal_mode={journal}")
    database.execute("PRAGMA cache_size=1")  # pages go to the disk before the end of a transaction
    if journal == "WAL":
        database.execute("UPDATE messages SET timestamp = timestamp + 1")
        database.commit()
    else:
        database.execute("DELETE FROM messages WHERE timestamp > 2000000000")
    for file in bag.glob("bag.db3*"):
        (killed / file.name).write_bytes(file.read_bytes())
    database.close()
    assert len(list(killed.iterdir())) > 1
    times, problems = _tags(killed)
    assert times == ALL
    assert "80 messages are whole" in problems[0]
    assert len(list(killed.glob("bag.db3*"))) > 1  # nothing there was changed


def test_image_encodings():
    grey = np.arange(48 * 64, dtype=np.uint8).reshape(48, 64)
    kind = STORES[2].types["sensor_msgs/msg/Image"]
    deep = (grey.astype(np.uint16) << 8) + 3
    for encoding, data, step in (("mono8", grey, 64), ("mono16", deep, 128), ("rgba8", np.repeat(grey, 4), 256)):
        raw = np.frombuffer(np.ascontiguousarray(data).tobytes(), dtype=np.uint8)
        message = kind(header(2, 0), 48, 64, encoding, 0, step, raw)
        np.testing.assert_allclose(grey_image(Path("a.bag"), message), deep if encoding == "mono16" else grey, atol=1)
    raw = np.frombuffer(deep.astype(">u2").tobytes(), dtype=np.uint8)
    np.testing.assert_array_equal(grey_image(Path("a.bag"), kind(header(2, 0), 48, 64, "16UC1", 1, 128, raw)), deep)
    with pytest.raises(InputError, match="yuv422"):
        grey_image(Path("a.bag"), kind(header(2, 0), 48, 64, "yuv422", 0, 128, np.zeros(48 * 128, dtype=np.uint8)))
    with pytest.raises(InputError, match="only 10 bytes"):
        grey_image(Path("a.bag"), kind(header(2, 0), 48, 64, "mono8", 0, 64, np.zeros(10, dtype=np.uint8)))
