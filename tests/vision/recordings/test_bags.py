"""Bags of both ROS versions: detections and images come back, of killed recorders as far as they are whole."""

from __future__ import annotations

import bz2
import sqlite3
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from rosbags.rosbag2 import CompressionMode, StoragePlugin

from tests.vision.bags import CAMERAS, CORNERS, PICTURES, STORES, header, write_bag
from tossid.errors import FileError, InputError
from tossid.objects import ObjectModel
from tossid.vision.cameras.camera import Camera
from tossid.vision.recordings.bag_contents import read_bag_detections, read_bag_images
from tossid.vision.recordings.recording import Recording
from tossid.vision.recordings.registry import format_named, recognized_format
from tossid.vision.recordings.rosbag import Bag, grey_image
from tossid.vision.setup.calibration import read_cameras, write_cameras
from tossid.vision.setup.layout import layout_of
from tossid.vision.setup.tagslam import write_tagslam

ALL = [round(1 + i / 10, 6) for i in range(20)]
"""Times of the frames of a whole bag [s]."""


@pytest.fixture
def set_up(tmp_path: Path, tagged: ObjectModel) -> Path:
    """The folder with calibration and layout beside its bags."""
    write_cameras(CAMERAS, tmp_path)
    write_tagslam(layout_of(tagged), tmp_path / "tagslam.yaml")
    return tmp_path


def assert_pictures(recording: Recording, numbers: range) -> None:
    """Each camera's frames of these numbers are the pictures that were written, at their times."""
    for name in ("left", "right"):
        for i, frame in zip(numbers, recording.run(recording.frames[name][numbers.start : numbers.stop]), strict=True):
            assert frame.t == pytest.approx(ALL[i], abs=1e-6)  # the offset of the right camera's clock is taken off
            np.testing.assert_allclose(frame.image, PICTURES[i], atol=1)  # colours to grey


def times_of(path: Path, camera: str = "left") -> tuple[list[float], tuple[str, ...]]:
    """Times of a camera's detections, and the problems."""
    found = read_bag_detections(path, CAMERAS, sigma=1.0)
    return [round(d.t, 6) for d in found.detections if d.camera == camera], found.problems


@pytest.mark.parametrize(
    ("version", "plugin", "rauch"),
    [(1, StoragePlugin.SQLITE3, False), (2, StoragePlugin.SQLITE3, False), (2, StoragePlugin.MCAP, True)],
)
def test_detections_and_images_come_back(set_up: Path, version: int, plugin: StoragePlugin, rauch: bool):
    path = write_bag(set_up, version, plugin=plugin, rauch=rauch)
    recording = read_bag_images(set_up)
    assert (recording.n_frames, recording.rate_hz) == (40, pytest.approx(10.0))
    assert_pictures(recording, range(5, 9))
    assert recording.read(recording.frames["left"][3]).camera == "left"
    if version == 1:
        packed = path.with_suffix(".bag.bz2")
        packed.write_bytes(bz2.compress(path.read_bytes()))
        path.unlink()
        path = packed
    found = read_bag_detections(path, CAMERAS, sigma=0.5)
    assert found.n_frames == {"left": 20, "right": 20}
    assert found.problems == ()
    for camera in CAMERAS:
        own = [d for d in found.detections if d.camera == camera.name]
        assert [round(d.t, 6) for d in own] == ALL
        for i, d in enumerate(own):
            np.testing.assert_allclose(d.corners, CORNERS + i)
            np.testing.assert_array_equal(d.corner_cov, np.tile(0.25 * np.eye(2), (4, 1, 1)))
            assert (d.tag_id, d.hamming, d.margin) == (7, 1, 55.0 if rauch else 0.0)


def test_missing_topics_are_named(set_up: Path):
    path = write_bag(set_up, 1)
    other = Camera("left", (64, 48), [60, 60, 32, 24], tag_topic="/elsewhere/tags")
    with pytest.raises(FileError, match="wanted /elsewhere/tags"):
        read_bag_detections(path, (other,), sigma=1.0)
    assert read_bag_detections(path, (*CAMERAS, other), sigma=1.0).n_frames["left"] == 20
    third = Camera("third", (64, 48), [60, 60, 32, 24], image_topic="/third/image")
    write_cameras([*CAMERAS, third], set_up)
    with pytest.raises(FileError, match="no images of third"):
        read_bag_images(set_up)


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
    corners = data["corners"]
    order = sorted(range(len(key)), key=lambda i: (key[i], corners[i, 0, 0]))
    mine = sorted(found, key=lambda d: ((d.camera, d.tag_id, d.t), d.corners[0, 0]))
    assert [(d.camera, d.tag_id) for d in mine] == [key[i][:2] for i in order]
    np.testing.assert_allclose([d.t for d in mine], [key[i][2] for i in order], atol=1e-6)
    np.testing.assert_allclose([d.corners for d in mine], corners[order], atol=1e-4)
    with Bag(folder / "tag_detections.bag.bz2") as bag:
        assert set(bag.types.values()) == {"apriltag_msgs/msg/ApriltagArrayStamped"}


def test_image_encodings():
    grey = np.arange(48 * 64, dtype=np.uint8).reshape(48, 64)
    deep = (grey.astype(np.uint16) << 8) + 3

    def read(encoding: str, data: np.ndarray, step: int, *, big: bool = False) -> np.ndarray:
        raw = np.frombuffer(np.ascontiguousarray(data).tobytes(), dtype=np.uint8)
        kind = STORES[2].types["sensor_msgs/msg/Image"]
        return grey_image(Path("a.bag"), kind(header(2, 0), 48, 64, encoding, int(big), step, raw))

    np.testing.assert_allclose(read("mono8", grey, 64), grey)
    np.testing.assert_allclose(read("rgba8", np.repeat(grey, 4), 256), grey, atol=1)
    np.testing.assert_array_equal(read("mono16", deep, 128), deep)
    np.testing.assert_array_equal(read("16UC1", deep.astype(">u2"), 128, big=True), deep)
    with pytest.raises(InputError, match="yuv422"):
        read("yuv422", deep, 128)
    with pytest.raises(InputError, match="only 10 bytes"):
        read("mono8", grey.flat[:10], 64)


# ---------------------------------------------------------------- of killed recorders, cut, or no bags


def cut(folder: Path, size: int | float, *, kept: int | None = None, **keys: object) -> Path:
    """An MCAP without its end: a share of its bytes, or all but so many; or only so many that are kept."""
    bag = write_bag(folder, 2, plugin=StoragePlugin.MCAP, **keys)
    (bag / "metadata.yaml").unlink()
    whole = (bag / "bag.mcap").read_bytes()
    end = int(size * len(whole)) if isinstance(size, float) else len(whole) - size
    (bag / "bag.mcap").write_bytes(whole[: end if kept is None else kept])
    return bag


def holding(name: str, content: bytes) -> Callable[[Path], Path]:
    def make(folder: Path) -> Path:
        (folder / name).write_bytes(content)
        return folder / name

    return make


@pytest.mark.parametrize(
    ("make", "says"),
    [
        (holding("a.bag", b"nonsense"), r"a\.bag.*can be read"),
        (holding("b.mcap", b""), r"b\.mcap.*can be read"),
        (holding("d.bag.bz2", b"no"), r"d\.bag\.bz2.*unpacked"),
        (lambda folder: folder, "holds no bag"),
        (lambda folder: folder / "none", "no such bag"),
        (lambda folder: cut(folder, 1, kept=60), "is not a bag that can be read"),
    ],
)
def test_what_is_no_bag_is_said(tmp_path: Path, make: Callable[[Path], Path], says: str) -> None:
    with pytest.raises(FileError, match=says):
        read_bag_detections(make(tmp_path), CAMERAS, sigma=1.0)


@pytest.mark.parametrize("plugin", list(StoragePlugin))
def test_a_bag_without_metadata_is_found(tmp_path: Path, plugin: StoragePlugin):
    bag = write_bag(tmp_path / "recording", 2, plugin=plugin)
    (bag / "metadata.yaml").unlink()
    said = f"{bag} has no metadata.yaml: 80 messages are whole, the last of 3.150 s"
    for path in (bag, bag.parent):
        # an MCAP's end says that it is whole
        assert times_of(path) == (ALL, (said,) if plugin is StoragePlugin.SQLITE3 else ())
        assert recognized_format(path) is format_named("rosbag")


@pytest.mark.parametrize("plugin", list(StoragePlugin))
@pytest.mark.parametrize("metadata", [None, "rosbag2_bagfile_information: {version: 9", "stale"])
def test_the_parts_of_a_bag_without_metadata_are_one_bag(set_up: Path, plugin: StoragePlugin, metadata: str | None):
    folder = set_up / "killed"
    folder.mkdir()
    for number, frames in ((2, range(4)), (10, range(4, 20))):
        bag = write_bag(set_up / str(number), 2, plugin=plugin, frames=frames)
        (part,) = bag.glob("bag.*")
        part.rename(folder / f"bag_{number}{part.suffix}")
    if metadata is not None:
        text = (bag / "metadata.yaml").read_text().replace("bag.", "bag_2.") if metadata == "stale" else metadata
        (folder / "metadata.yaml").write_text(text)
    assert times_of(folder)[0] == ALL
    recording = read_bag_images(folder)
    assert recording.n_frames == 40
    assert_pictures(recording, range(2, 7))


@pytest.mark.parametrize("mode", [CompressionMode.MESSAGE, CompressionMode.FILE])
def test_compression_that_missing_metadata_would_name_is_seen(tmp_path: Path, mode: CompressionMode):
    (write_bag(tmp_path, 2, compression=mode) / "metadata.yaml").unlink()
    assert times_of(tmp_path)[0] == ALL


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
    times, problems = times_of(killed)
    assert times == ALL
    assert "80 messages are whole" in problems[0]
    assert len(list(killed.glob("bag.db3*"))) > 1  # nothing there was changed


@pytest.mark.parametrize("share", [0.3, 0.98])
def test_a_truncated_bag_is_read_as_far_as_it_is_whole_and_reported(tmp_path: Path, share: float):
    path = write_bag(tmp_path, 1)
    path.write_bytes(path.read_bytes()[: int(share * path.stat().st_size)])
    times, (problem,) = times_of(path)
    assert times == ALL[: len(times)]
    assert len(times) > 0.5 * share * 20
    assert "breaks off" in problem
    assert "messages are whole" in problem


@pytest.mark.parametrize(
    ("packed", "chunk", "size"),
    [("", 3, 0.35), ("lz4", 7, 0.97), ("zstd", 3, 1), ("", 7, 37), ("zstd", 3, 300), ("", 20, 0.5)],
)
def test_an_mcap_without_its_end_is_read_as_far_as_it_is_whole(set_up: Path, packed: str, chunk: int, size: int):
    """Also the part of a chunk before the cut, where it is not packed."""
    bag = cut(set_up, size, packed=packed, chunk=chunk)
    times, (problem,) = times_of(set_up, "right")
    n = len(times)
    assert times == ALL[:n]  # no message is lost, doubled or out of order
    assert times_of(set_up)[0] in (ALL[:n], ALL[: n + 1])
    share = size if isinstance(size, float) else 1.0
    assert n >= (chunk * int(0.9 * share * 20 / chunk) if chunk < 20 else 8)
    count, words = problem.split("end: ")[1].split(" ", 1)
    assert problem.startswith(f"{bag / 'bag.mcap'} breaks off before its end: ")
    assert 4 * n <= int(count) <= 4 * n + 3  # two topics of either camera
    assert words.startswith("messages are whole, the last of")
    recording = read_bag_images(bag, set_up)
    assert "breaks off" in recording.problems[0]
    assert_pictures(recording, range(n))


def test_a_damaged_chunk_ends_an_mcap_without_its_end(tmp_path: Path):
    bag = cut(tmp_path, 40, packed="zstd", chunk=5)
    content = bytearray((bag / "bag.mcap").read_bytes())
    third = [at for at in range(len(content)) if content[at : at + 4] == b"\x28\xb5\x2f\xfd"][2]
    content[third + 4 : third + 30] = bytes(26)
    (bag / "bag.mcap").write_bytes(content)
    found = read_bag_detections(bag, CAMERAS, sigma=1.0)
    assert found.n_frames == {"left": 10, "right": 10}
    assert "40 messages are whole" in found.problems[0]
