"""`tossid detect` of many recordings."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pipelines.cli import app
from pipelines.files.project import newest_recording
from tests.pipelines.conftest import one_line
from tossid.vision.recordings.npz import read_detections

EACH = 20
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


@pytest.mark.parametrize(
    ("keys", "says"),
    [
        (["recordings=none/*"], "nothing fits 'none/*'"),
        (["recordings=raw/*", "threads=2"], "threads: is for one recording"),
        (["recordings=raw/*", "recording=raw/a"], "recording: is for one recording"),
        (["recordings=*/a"], "several are named 'a'"),
    ],
)
def test_patterns_of_recordings_that_are_refused(
    project: Path, capfd: pytest.CaptureFixture[str], keys: list[str], says: str
) -> None:
    for folder in ("raw", "more"):
        (project / folder / "a").mkdir(parents=True)
    assert app.run(["detect", *keys]) == 2
    assert says in one_line(capfd.readouterr().err)
