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
from tossid.vision.recordings.registry import format_named, recognized_format
from tossid.vision.recordings.rosbag import Bag, grey_image
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
    path = write_bag(tmp_path, version, plugin=plugin, rauch=rauch)
    if version == 1:
        packed = path.with_suffix(".bag.bz2")
        packed.write_bytes(bz2.compress(path.read_bytes()))
        path.unlink()
        path = packed
    found = read_bag_detections(path, CAMERAS, sigma=0.5)
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


def _cut_in_half(folder: Path) -> Path:
    bag = write_bag(folder, 2)
    (data,) = bag.glob("*.db3")
    data.write_bytes(data.read_bytes()[: data.stat().st_size // 2])
    return bag


def _holding(name: str, content: bytes | None) -> Callable[[Path], Path]:
    """A file, or where there is no content an empty folder."""

    def make(folder: Path) -> Path:
        path = folder / name
        path.mkdir() if content is None else path.write_bytes(content)
        return path

    return make


@pytest.mark.parametrize(
    ("make", "says"),
    [
        (_holding("a.bag", b"nonsense"), r"a\.bag.*can be read"),
        (_holding("b.mcap", b""), r"b\.mcap.*can be read"),
        (_holding("c.bag", b""), r"c\.bag.*can be read"),
        (_holding("d.bag.bz2", b"no"), r"d\.bag\.bz2.*unpacked"),
        (_holding("empty", None), "holds no bag"),
        (lambda folder: folder / "none", "no such bag"),
        (_cut_in_half, "damaged|cannot|can be read"),
        *(
            (lambda folder, kept=kept: _cut(folder, 1, kept=kept), "is not a bag that can be read")
            for kept in (0, 8, 60)
        ),
    ],
)
def test_what_is_no_bag_is_said(tmp_path: Path, make: Callable[[Path], Path], says: str) -> None:
    with pytest.raises(FileError, match=says):
        read_bag_detections(make(tmp_path), CAMERAS, sigma=1.0)


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


@pytest.mark.parametrize("share", [0.3, 0.98])
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


def _cut(tmp_path: Path, size: int | float, *, kept: int | None = None, **keys: object) -> Path:
    """An MCAP without its end: a share of its bytes, or all but so many; or only so many that are kept."""
    bag = write_bag(tmp_path, 2, plugin=StoragePlugin.MCAP, **keys)
    (bag / "metadata.yaml").unlink()
    whole = (bag / "bag.mcap").read_bytes()
    end = int(size * len(whole)) if isinstance(size, float) else len(whole) - size
    (bag / "bag.mcap").write_bytes(whole[: end if kept is None else kept])
    return bag


@pytest.mark.parametrize(("packed", "chunk"), [("", 3), ("lz4", 7), ("zstd", 3)])
@pytest.mark.parametrize("size", [0.35, 0.97, 1, 37, 300])
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
