"""Bags: what was written comes back, of both ROS versions, packed or plain; and damage is said."""

from __future__ import annotations

import bz2
from pathlib import Path

import numpy as np
import pytest
from rosbags.rosbag2 import StoragePlugin

from tests.vision.bags import CAMERAS, CORNERS, PICTURES, STORES, header, write_bag
from tossid.errors import FileError, InputError
from tossid.objects import ObjectModel
from tossid.vision.calibration import read_cameras, write_cameras
from tossid.vision.camera import Camera
from tossid.vision.film import read_bag_images
from tossid.vision.layout import layout_of
from tossid.vision.rosbag import Bag, grey_image, read_bag_detections
from tossid.vision.tagslam import write_tagslam


def _set_up(folder: Path, tagged: ObjectModel) -> None:
    write_cameras(CAMERAS, folder)
    write_tagslam(layout_of(tagged), folder / "tagslam.yaml")


@pytest.mark.parametrize(
    ("version", "plugin", "rauch"),
    [(1, StoragePlugin.SQLITE3, False), (2, StoragePlugin.SQLITE3, False), (2, StoragePlugin.MCAP, True)],
)
def test_detections_come_back(tmp_path: Path, version: int, plugin: StoragePlugin, rauch: bool):
    found = read_bag_detections(write_bag(tmp_path, version, plugin=plugin, rauch=rauch), CAMERAS, sigma=0.5)
    assert found.n_frames == {"left": 20, "right": 20}
    assert found.problems == ()
    assert len(found.detections) == 40
    for camera in CAMERAS:
        own = [d for d in found.detections if d.camera == camera.name]
        for i, d in enumerate(own):
            assert d.t == pytest.approx(1.0 + i / 10, abs=1e-6)  # the offset of the right camera's clock is taken off
            np.testing.assert_allclose(d.corners, CORNERS + i)
            np.testing.assert_array_equal(d.corner_cov, np.tile(0.25 * np.eye(2), (4, 1, 1)))
            assert (d.tag_id, d.hamming, d.margin) == (7, 1, 55.0 if rauch else 0.0)


@pytest.mark.parametrize("version", [1, 2])
def test_images_come_back(tmp_path: Path, tagged: ObjectModel, version: int):
    write_bag(tmp_path, version)
    _set_up(tmp_path, tagged)
    recording = read_bag_images(tmp_path)
    assert recording.n_frames == 40
    assert recording.rate_hz == pytest.approx(10.0)
    for name in ("left", "right"):
        files = recording.frames[name]
        for i, frame in enumerate(recording.run(files[5:9]), start=5):
            assert frame.t == pytest.approx(1.0 + i / 10, abs=1e-6)
            np.testing.assert_allclose(frame.image, PICTURES[i], atol=1)  # colours to grey
    assert recording.read(recording.frames["left"][3]).camera == "left"


def test_a_packed_bag_is_unpacked(tmp_path: Path):
    plain = write_bag(tmp_path, 1)
    packed = tmp_path / "packed" / "b.bag.bz2"
    packed.parent.mkdir()
    packed.write_bytes(bz2.compress(plain.read_bytes()))
    assert len(read_bag_detections(packed.parent, CAMERAS, sigma=1.0).detections) == 40


@pytest.mark.parametrize("share", [0.3, 0.7, 0.98])
def test_of_a_bag_that_was_cut_what_is_whole_is_read_and_it_is_said(tmp_path: Path, share: float):
    path = write_bag(tmp_path, 1)
    whole = path.read_bytes()
    path.write_bytes(whole[: int(share * len(whole))])
    found = read_bag_detections(path, CAMERAS, sigma=1.0)
    assert 0.5 * share * 40 < len(found.detections) <= 40
    assert len(found.detections) == sum(found.n_frames.values())
    (problem,) = found.problems
    assert "breaks off" in problem
    assert "messages are whole" in problem


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


def test_missing_topics_are_named(tmp_path: Path, tagged: ObjectModel):
    path = write_bag(tmp_path, 1)
    other = (Camera("left", (64, 48), [60, 60, 32, 24], tag_topic="/elsewhere/tags"),)
    with pytest.raises(FileError, match="wanted /elsewhere/tags"):
        read_bag_detections(path, other, sigma=1.0)
    found = read_bag_detections(path, (*CAMERAS, *other[:1]), sigma=1.0)
    assert found.n_frames["left"] == 20
    third = Camera("third", (64, 48), [60, 60, 32, 24], image_topic="/third/image")
    write_cameras([*CAMERAS, third], tmp_path)
    write_tagslam(layout_of(tagged), tmp_path / "tagslam.yaml")
    with pytest.raises(FileError, match="no images of third"):
        read_bag_images(tmp_path)


def test_image_encodings():
    grey = np.arange(48 * 64, dtype=np.uint8).reshape(48, 64)
    kind = STORES[2].types["sensor_msgs/msg/Image"]
    deep = (grey.astype(np.uint16) << 8) + 3
    for encoding, data, step in (("mono8", grey, 64), ("mono16", deep, 128), ("rgba8", np.repeat(grey, 4), 256)):
        raw = np.frombuffer(np.ascontiguousarray(data).tobytes(), dtype=np.uint8)
        message = kind(header(2, 0), 48, 64, encoding, 0, step, raw)
        np.testing.assert_allclose(grey_image(message), grey, atol=1)
    with pytest.raises(InputError, match="yuv422"):
        grey_image(kind(header(2, 0), 48, 64, "yuv422", 0, 128, np.zeros(48 * 128, dtype=np.uint8)))
    with pytest.raises(InputError, match="only 10 bytes"):
        grey_image(kind(header(2, 0), 48, 64, "mono8", 0, 64, np.zeros(10, dtype=np.uint8)))


@pytest.mark.parametrize("test", [4, 15, 16, 17, 23])
def test_tagslams_bags_are_read(shared_data: Path, test: int):
    """As its detections were extracted by others."""
    folder = shared_data / "tagslam_test" / f"test_{test}"
    found = read_bag_detections(folder, read_cameras(folder), sigma=1.0).detections
    data = np.load(folder / "detections.npz", allow_pickle=False)
    key = [
        (str(data["camera_names"][c]), int(i), t * 1e-9)
        for c, i, t in zip(data["camera"], data["tag_id"], data["t_ns"], strict=True)
    ]
    first = data["corners"][:, 0, 0]
    order = sorted(range(len(key)), key=lambda i: (key[i], first[i]))
    mine = sorted(found, key=lambda d: ((d.camera, d.tag_id, d.t), d.corners[0, 0]))
    assert [(d.camera, d.tag_id) for d in mine] == [key[i][:2] for i in order]
    np.testing.assert_allclose([d.t for d in mine], [key[i][2] for i in order], atol=1e-6)
    corners = data["corners"]
    np.testing.assert_allclose([d.corners for d in mine], corners[order], atol=1e-4)
    with Bag(folder / "tag_detections.bag.bz2") as bag:
        assert set(bag.types.values()) == {"apriltag_msgs/msg/ApriltagArrayStamped"}
