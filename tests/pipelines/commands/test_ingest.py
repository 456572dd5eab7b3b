"""`tossid ingest`: every kind of recording becomes a dataset, and a damaged one is named."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import yaml
from rosbags.rosbag1 import Writer
from rosbags.typesys import Stores, get_typestore
from rosbags.typesys.stores.ros1_noetic import builtin_interfaces__msg__Time as Time
from rosbags.typesys.stores.ros1_noetic import sensor_msgs__msg__CompressedImage as CompressedImage
from rosbags.typesys.stores.ros1_noetic import std_msgs__msg__Header as Header
from scipy.ndimage import gaussian_filter1d

from pipelines.cli import app
from pipelines.config.compose import load
from pipelines.config.schemas import SynthesizeConfig
from pipelines.files.project import newest_dataset, newest_recording
from tests.pipelines.conftest import one_line
from tossid.motion.sessions import as_recorded
from tossid.objects import load_object
from tossid.rotations import geodesic_angle
from tossid.settings.tracking import StreamSettings, TrackSettings
from tossid.store import read_dataset, write_tum
from tossid.synthesis.tosses import make_tosses
from tossid.types import Phase
from tossid.vision.pose_graph.stream import track_stream
from tossid.vision.recordings.formats.frames import read_recording


def synthesis(*keys: str) -> SynthesizeConfig:
    return load("synthesize", SynthesizeConfig, keys)


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


def test_ingest_reads_tum_and_ends_tosses_at_rest(project: Path, answer: Any) -> None:
    config = synthesis("engine=lcp", "tosses=4", "seconds=1.2", "rest_s=0.5")
    tosses, _ = make_tosses(config, load_object(config.object), np.random.default_rng(5))
    write_tum(project / "poses", tosses)
    made = answer("ingest", "source=tum", "source.path=poses", "object=cube")
    found = read_dataset(project / made["out"])
    assert made["source"] == "tum"
    assert made["rate_hz"] == pytest.approx(148.0)
    for one, true in zip(found.tosses, tosses, strict=True):
        assert len(one) < len(true)  # half a second of rest is cut
        flight = true.phase[: len(one)] == Phase.FLIGHT
        flight[1:] &= flight[:-1]
        assert np.median(np.abs(one.v[flight, :3] - true.v[: len(one)][flight, :3])) < 0.02


def test_what_a_smoother_made_is_refused_unless_it_is_asked_for(
    project: Path, answer: Any, capfd: pytest.CaptureFixture[str]
) -> None:
    config = synthesis("engine=lcp", "tosses=3", "seconds=1.2")
    tosses, _ = make_tosses(config, load_object(config.object), np.random.default_rng(5))
    for toss in tosses:
        toss.q[:, :3] = gaussian_filter1d(toss.q[:, :3], 15.0, axis=0)
    write_tum(project / "poses", tosses)
    keys = ["source=tum", "source.path=poses", "object=cube", "out=made.h5"]
    assert app.run(["ingest", *keys, "--quiet"]) == 2
    line = one_line(capfd.readouterr().err)
    assert "the poses are a smoother's, not measured: they do not fall by gravity" in line
    assert "smoothed=keep" in line
    assert not (project / "made.h5").exists()
    assert answer("ingest", *keys, "smoothed=keep")["n_tosses"] == 3


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


def test_ingest_finds_where_a_camera_stands(
    film: Path, project: Path, answer: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """From the film as a whole, and, of one that is taken for long, from stretches of it."""
    (recording,) = (film / "data" / "raw").iterdir()
    told = answer("ingest", f"source.path={recording}", "out=told.h5")
    shutil.copytree(recording, project / "blind")
    poses = yaml.safe_load((recording / "camera_poses.yaml").read_text())
    (project / "blind" / "camera_poses.yaml").write_text(yaml.safe_dump({"cam0": poses["cam0"]}))
    whole = answer("ingest", "source.path=blind", "out=whole.h5")
    sizes = StreamSettings(whole_frames=50, stretches=5, stretch_frames=20, piece=0.3, disorder=0.2, border=0.1)

    def in_pieces(*args: Any, settings: TrackSettings, **rest: Any) -> Any:
        return track_stream(*args, settings=replace(settings, stream=sizes), **rest)

    monkeypatch.setattr("tossid.ingestion.stages.track_stream", in_pieces)
    parts = answer("ingest", "source.path=blind", "out=parts.h5")
    assert told["track"]["cameras"] == {}
    (true,) = read_dataset(project / "told.h5").tosses
    for name, made in (("whole", whole), ("parts", parts)):
        assert list(made["track"]["cameras"]) == ["cam1"]
        assert made["track"]["n_poses"] > 0.95 * told["track"]["n_poses"]
        (toss,) = read_dataset(project / f"{name}.h5").tosses
        both, at, true_at = np.intersect1d(np.round(toss.t, 6), np.round(true.t, 6), return_indices=True)
        assert len(both) > 0.9 * len(true.t)
        assert np.median(np.linalg.norm(toss.q[at, :3] - true.q[true_at, :3], axis=1)) < 1e-3
    assert sorted(path.name for path in project.glob("*.h5*")) == ["parts.h5", "told.h5", "whole.h5"]


def test_ingest_reads_the_real_cube(project: Path, shared_data: Path, answer: Any) -> None:
    folder = project / "some"
    folder.mkdir()
    for path in sorted((shared_data / "contactnets_cube").glob("*.pt"))[:12]:
        (folder / path.name).symlink_to(path)
    made = answer("ingest", "source=contactnets", f"source.path={folder}", "object=cube", "out=cube.h5")
    assert (made["object"], made["n_tosses"], made["rate_hz"]) == ("cube", 12, 148.0)
    assert made["splits"] == {"train": 6, "validation": 4, "test": 2}
    assert made["provenance"]["source_path"] == str(folder)


@pytest.mark.parametrize(
    ("damage", "words"),
    [
        (
            lambda film: (film / "frames" / "cam0" / "0000000001000000000.jpg").write_bytes(b"no image"),
            "0000000001000000000.jpg",
        ),
        (lambda film: (film / "tagslam.yaml").write_text("bodies: ["), "tagslam.yaml"),
        (lambda film: (film / "cameras.yaml").write_text("{}"), "cameras.yaml"),
        (lambda film: (film / "object.yaml").write_text("name: 3\nmass: 2\n"), "object.yaml"),
    ],
)
def test_a_damaged_recording_is_one_line_that_names_the_file(
    film: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str], damage: Any, words: str
) -> None:
    import shutil

    broken = tmp_path / "broken"
    shutil.copytree(film / newest_recording(film / "data" / "raw"), broken)
    damage(broken)
    out = tmp_path / "a.h5"
    out.write_text("old")
    assert app.run(["ingest", f"source.path={broken}", f"out={out}", "--quiet"]) == 2
    assert words in one_line(capfd.readouterr().err)
    assert out.read_text() == "old"


def test_a_dataset_must_be_named_as_one(project: Path, capfd: pytest.CaptureFixture[str]) -> None:
    (project / "poses").mkdir()
    assert app.run(["ingest", "source=tum", "source.path=poses", "out=notes.txt"]) == 2
    assert "Did you mean 'notes.h5'?" in one_line(capfd.readouterr().err)


@pytest.mark.parametrize("after", [pytest.param("reading", marks=pytest.mark.slow), "detect"])
def test_ctrl_c_during_ingest(film: Path, tmp_path: Path, after: str) -> None:
    out = tmp_path / "a.h5"
    out.write_text("old")
    recording = film / newest_recording(film / "data" / "raw")
    with subprocess.Popen(
        [sys.executable, "-m", "pipelines.cli.app", "ingest", f"source.path={recording}", f"out={out}"],
        stderr=subprocess.PIPE,
        text=True,
        cwd=tmp_path,
        env={**os.environ, "OMP_NUM_THREADS": "1"},
    ) as running:
        assert running.stderr is not None
        assert "images" in running.stderr.readline()
        if after == "detect":
            time.sleep(0.3)
        running.send_signal(signal.SIGINT)
        err = running.stderr.read()
        code = running.wait(timeout=30)
    assert code == 130
    assert "interrupted" in err.strip().splitlines()[-1]
    assert "Traceback" not in err
    assert out.read_text() == "old"
    assert [path.name for path in tmp_path.iterdir()] == ["a.h5"]


def test_copies_and_turns_of_the_real_cube_are_reported_and_undone_where_asked(
    project: Path, shared_data: Path, answer: Any, capfd: pytest.CaptureFixture[str]
) -> None:
    folder = project / "some"
    folder.mkdir()
    for name in [*range(80), 140]:
        path = shared_data / "contactnets_cube" / f"{name}.pt"
        if path.exists():
            (folder / path.name).symlink_to(path)
    keys = ["source=contactnets", f"source.path={folder}", "object=cube", "out=cube.h5"]
    assert app.run(["ingest", *keys, "--quiet"]) == 0
    said = capfd.readouterr().err
    assert "1 toss is a copy of an earlier one, turned about the vertical: 140 of 56 (-169.0°)" in said
    assert "recordings were turned about the vertical after they were tracked" in said
    assert "turned=undo" in said
    assert "kept, each in the split of its first" in said
    kept = read_dataset(project / "cube.h5")
    split = {toss.name: toss.split for toss in kept.tosses}
    assert split["140"] == split["56"]
    assert set(split.values()) == {"train", "validation", "test"}
    made = answer("ingest", *keys, "turned=undo", "copies=set_aside")
    back = read_dataset(project / "cube.h5")
    assert made["splits"].get("none") == 1
    assert {toss.name: toss.split for toss in back.tosses} == {**split, "140": ""}
    assert back.order is not None
    for one, other in zip(kept.tosses, back.tosses, strict=True):
        np.testing.assert_allclose(as_recorded(other, back.order).q[:, :3], one.q[:, :3], atol=1e-12)
        np.testing.assert_allclose(other.q[:, 2], one.q[:, 2], atol=1e-12)
    way = np.array([toss.q[5, :2] - toss.q[0, :2] for toss in back.tosses])
    assert np.median(np.abs(np.arctan2(way[:, 1], way[:, 0]))) < np.deg2rad(10)
    (session,) = back.order.sessions
    assert session.level is not None
    assert np.rad2deg(session.level[1]) == pytest.approx(-0.5, abs=0.15)


def test_the_real_die_lost_a_frame_at_the_first_impact(project: Path, shared_data: Path, answer: Any) -> None:
    data, folder = shared_data / "mit_die", project / "some"
    folder.mkdir()
    for path in sorted((data / "levelled").glob("drop_[01]*.txt")):
        (folder / path.name).symlink_to(path)
    keys = ["source=tum", f"source.path={folder}", "object=custom", "object.name=die", "object.friction=0.3"]
    made = answer("ingest", *keys, f"object.path={data / 'die.xml'}", "out=die.h5", "lost=undo")
    first, later = made["lost"]["first"], made["lost"]["later"]
    assert first["is_lossy"]
    assert not later["is_lossy"]
    assert first["counts"][1] > 12
    assert first["chance"] + later["chance"] + sum(first["counts"][2:]) + sum(later["counts"][1:]) <= 1
    lost = [impact for impact in made["lost"]["judged"] if impact["first"] and impact["lost"] == 1]
    skips = [1e3 * impact["skip"] for impact in lost]
    assert 3.6 < min(skips) < np.median(skips) < max(skips) < 4.5
    assert np.median(skips) == pytest.approx(4.0, abs=0.2)
    assert np.median([1e3 * impact["misfit"] for impact in lost]) < 0.2
    steps = {toss.name: np.diff(toss.t) for toss in read_dataset(project / "die.h5").tosses}
    for impact in lost:
        assert steps[impact["toss"]][impact["last"]] == pytest.approx(8e-3)
    assert sum(np.count_nonzero(h > 5e-3) for h in steps.values()) == len(lost)
    assert made["splits"]["none"] == first["impacts"] - sum(first["counts"])
