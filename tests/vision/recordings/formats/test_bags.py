"""Detections and images of bags, of both ROS versions."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from rosbags.rosbag2 import StoragePlugin

from tests.vision.bags import CAMERAS, CORNERS, PICTURES, write_bag
from tossid.errors import FileError
from tossid.objects import ObjectModel
from tossid.vision.cameras.camera import Camera
from tossid.vision.recordings.formats.bags import read_bag_detections, read_bag_images
from tossid.vision.recordings.rosbag import Bag
from tossid.vision.setup.calibration import read_cameras, write_cameras
from tossid.vision.setup.layout import layout_of
from tossid.vision.setup.tagslam import write_tagslam


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
