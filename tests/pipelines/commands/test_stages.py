"""`tossid detect`, `track` and `segment`: the stages of ingest, from files to files."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pipelines.files.project import newest_recording
from tossid.store import read_dataset
from tossid.vision.recordings.npz import read_detections
from tossid.vision.setup.calibration import read_cameras

EACH = 6
"""Frames of each camera."""


def test_many_recordings_are_searched_by_workers_and_once(film: Path, project: Path, answer: Any) -> None:
    recording = film / newest_recording(film / "data" / "raw")
    for name in ("a", "b"):
        shutil.copytree(recording, project / "raw" / name)
        for camera in (project / "raw" / name / "frames").iterdir():
            for frame in sorted(camera.iterdir())[EACH:]:
                frame.unlink()
    (project / "raw" / "broken").mkdir()
    keys = ["detect", "recordings=raw/*", "out=found", "workers=2"]
    alone = answer("detect", "recording=raw/a", "out=alone.npz")
    many = answer(*keys)
    assert [Path(row["recording"]).name for row in many["recordings"]] == ["a", "b"]
    assert "broken" in many["failed"][0]["recording"]
    for row in many["recordings"]:
        assert row["counts"] == alone["counts"]
        for one, other in zip(read_detections(row["out"]), read_detections(alone["out"]), strict=True):
            np.testing.assert_allclose(one.corners, other.corners, rtol=1e-12)
    before = {name: Path("found", name, "detections.npz").stat().st_mtime_ns for name in "ab"}
    gone = max(path for path in (project / "raw" / "b" / "frames").rglob("*") if path.is_file())
    gone.unlink()
    again = answer(*keys[:-1], "workers=1")
    after = {name: Path("found", name, "detections.npz").stat().st_mtime_ns for name in "ab"}
    assert after["a"] == before["a"]
    assert after["b"] > before["b"]
    assert again["recordings"][0] == many["recordings"][0]
    assert again["recordings"][1]["n_images"] == many["recordings"][1]["n_images"] - 1


def test_a_tagslam_set_up_is_tracked_as_it_is(project: Path, shared_data: Path, answer: Any) -> None:
    """From TagSLAM's folder: poses of its wand, and the calibration that the graph found, in TagSLAM's own form."""
    found = answer("track", f"recording={shared_data / 'tagslam_test' / 'test_4'}", "out=wand.npz")
    assert found["bodies"] == {"wand": 101}
    assert found["n_poses"] == found["n_steps"] == 101
    assert found["dropped_tags"]["id on no body"] == 21757
    assert set(found["cameras"]) == {f"cam{i}" for i in range(8)}
    assert found["problems"] == []
    assert len((project / "wand.txt").read_text().splitlines()) == 102
    cameras = read_cameras(project / "wand_set_up")
    assert len(cameras) == 8
    assert all(camera.T_rig_cam_cov is not None for camera in cameras)


def test_the_three_stages_give_what_ingest_gives(film: Path, monkeypatch: pytest.MonkeyPatch, answer: Any) -> None:
    monkeypatch.chdir(film)
    whole = answer("ingest", "out=whole.h5")
    detected = answer("detect")
    tracked = answer("track")
    parts = answer("segment", "out=parts.h5")
    assert parts["n_frames"] == whole["n_frames"]
    for one, other in zip(read_dataset(Path("whole.h5")).tosses, read_dataset(Path("parts.h5")).tosses, strict=True):
        np.testing.assert_array_equal(one.q, other.q)
        np.testing.assert_array_equal(one.v_cov, other.v_cov)
    assert answer("info", detected["out"])["n_detections"] == detected["n_detections"]
    assert answer("info", tracked["out"])["n_frames"] == tracked["n_poses"]
    assert answer("info", tracked["tum"])["n_frames"] == tracked["n_poses"]
    assert answer("info", str(newest_recording()))["object"] == "cube"
