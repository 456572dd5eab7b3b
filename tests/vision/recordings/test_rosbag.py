"""Bags: what was written comes back, of both ROS versions, packed or plain; and damage is said."""

from __future__ import annotations

import bz2
from pathlib import Path

import numpy as np
import pytest
from rosbags.rosbag2 import StoragePlugin

from tests.vision.bags import CAMERAS, STORES, header, write_bag
from tossid.errors import FileError, InputError
from tossid.vision.recordings.formats.bags import read_bag_detections
from tossid.vision.recordings.rosbag import grey_image


def test_a_packed_bag_is_unpacked(tmp_path: Path):
    plain = write_bag(tmp_path, 1)
    packed = tmp_path / "packed" / "b.bag.bz2"
    packed.parent.mkdir()
    packed.write_bytes(bz2.compress(plain.read_bytes()))
    assert len(read_bag_detections(packed.parent, CAMERAS, sigma=1.0).detections) == 40


@pytest.mark.parametrize("plugin", list(StoragePlugin))
def test_a_cut_ros2_bag_is_an_error(tmp_path: Path, plugin: StoragePlugin):
    path = write_bag(tmp_path, 2, plugin=plugin)
    (data,) = [file for file in path.iterdir() if file.suffix in (".db3", ".mcap")]
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
