"""`tossid ingest`: every kind of recording becomes a dataset, and a damaged one is named."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from rosbags.rosbag1 import Writer
from rosbags.typesys import Stores, get_typestore
from rosbags.typesys.stores.ros1_noetic import (
    builtin_interfaces__msg__Time as Time,
)
from rosbags.typesys.stores.ros1_noetic import (
    sensor_msgs__msg__CompressedImage as CompressedImage,
)
from rosbags.typesys.stores.ros1_noetic import (
    std_msgs__msg__Header as Header,
)

from pipelines.cli import app
from pipelines.files.project import newest_dataset, newest_recording
from tossid.rotations import geodesic_angle
from tossid.store import read_dataset
from tossid.vision.recordings.formats.frames import read_recording


def test_ingest_finds_the_newest_recording_and_its_tosses(
    film: Path, monkeypatch: pytest.MonkeyPatch, answer: Any
) -> None:
    monkeypatch.chdir(film)
    recording = newest_recording()
    made = answer("ingest")
    assert made["out"] == f"data/datasets/{recording.name}.h5"
    assert newest_dataset() == Path(made["out"])
    info = answer("info", made["out"])
    assert {name: made[name] for name in info} == info
    (true,), (found,) = read_dataset(recording / "truth.h5").tosses, read_dataset(Path(made["out"])).tosses
    rate = 148.0
    assert abs(found.t[0] - true.t[0]) * rate <= 3
    assert abs(found.t[-1] - true.t[-1]) * rate <= 3
    same = np.abs(true.t[:, None] - found.t[None]) < 1e-4
    i, j = np.nonzero(same)
    assert np.median(np.linalg.norm(true.q[i, :3] - found.q[j, :3], axis=1)) < 0.5e-3
    assert np.median(geodesic_angle(true.q[i, 3:7], found.q[j, 3:7])) < np.radians(0.3)


def test_ingest_reads_videos_and_bags_as_it_reads_frames(
    film: Path, project: Path, answer: Any, tmp_path_factory: pytest.TempPathFactory
) -> None:
    """The same film as frames, as a video for each camera, and as a bag of compressed images."""
    (recording,) = (film / "data" / "raw").iterdir()
    frames = answer("ingest", f"source.path={recording}", "out=frames.h5")
    opened = read_recording(recording)
    videos, bags = (tmp_path_factory.mktemp(name) for name in ("videos", "bags"))
    for folder in (videos, bags):
        for name in ("cameras.yaml", "camera_poses.yaml", "tagslam.yaml", "object.yaml", "object.xml"):
            (folder / name).write_bytes((recording / name).read_bytes())
    store = get_typestore(Stores.ROS1_NOETIC)
    with Writer(bags / "film.bag") as bag:
        for camera in opened.cameras:
            files = opened.frames[camera.name]
            topic = bag.add_connection(f"{camera.image_topic}/compressed", CompressedImage.__msgtype__, typestore=store)
            codec = cv2.VideoWriter_fourcc(*"FFV1")
            video = cv2.VideoWriter(str(videos / f"{camera.name}.avi"), codec, 148.0, camera.resolution, False)
            for file in files:
                stamp = Time(file.t_ns // 10**9, file.t_ns % 10**9)
                data = np.frombuffer(file.path.read_bytes(), dtype=np.uint8)
                message = CompressedImage(Header(0, stamp, ""), "jpeg", data)
                bag.write(topic, file.t_ns, store.serialize_ros1(message, CompressedImage.__msgtype__))
                video.write(opened.read(file).image)
            video.release()
            (videos / f"{camera.name}.txt").write_text("\n".join(f"{file.t_ns * 1e-9:.9f}" for file in files))
    for source, folder in (("video", videos), ("rosbag", bags)):
        found = answer("ingest", f"source={source}", f"source.path={folder}", f"out={source}.h5")
        assert found["source"] == source
        assert found["n_tosses"] == frames["n_tosses"]
        (mine,), (theirs,) = (read_dataset(Path(f"{name}.h5")).tosses for name in (source, "frames"))
        np.testing.assert_allclose(mine.q, theirs.q, atol=1e-6)


def test_copies_and_turns_of_the_real_cube_are_reported_and_undone_where_asked(
    project: Path, shared_data: Path, answer: Any, capfd: pytest.CaptureFixture[str]
) -> None:
    folder = project / "some"
    folder.mkdir()
    for name in [*range(40, 80), 140]:
        path = shared_data / "contactnets_cube" / f"{name}.pt"
        if path.exists():
            (folder / path.name).symlink_to(path)
    keys = ["source=contactnets", f"source.path={folder}", "object=cube", "out=cube.h5"]
    assert app.run(["ingest", *keys, "--quiet"]) == 0
    said = capfd.readouterr().err
    assert "1 toss is a copy of an earlier one, turned about the vertical: 140 of 56 (-169.0°)" in said
    assert "kept, each in the split of its first" in said
    split = {toss.name: toss.split for toss in read_dataset(project / "cube.h5").tosses}
    assert split["140"] == split["56"]
    made = answer("ingest", *keys, "turned=undo", "copies=set_aside")
    assert (made["object"], made["rate_hz"], made["provenance"]["source_path"]) == ("cube", 148.0, str(folder))
    assert made["splits"].get("none") == 1
    back = read_dataset(project / "cube.h5")
    assert {toss.name: toss.split for toss in back.tosses} == {**split, "140": ""}
    assert back.order is not None
    assert np.abs(back.order.turn[:, 1:3]).max() == 0.0  # about the vertical alone
    velocity = np.array([toss.v[0, :2] for toss in back.tosses])
    assert np.abs(np.arctan2(*velocity.T[::-1])).max() < 0.3
