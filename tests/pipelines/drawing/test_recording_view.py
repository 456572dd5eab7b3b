"""What is shown of a recording is what was recorded."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from pipelines.cli.console import Console
from pipelines.commands.view import happening
from pipelines.config.compose import load
from pipelines.config.schemas import ViewConfig
from pipelines.drawing.recording_view import ViewContent, faces_in_view, misplaced, recording_content
from tossid.rotations import geodesic_angle
from tossid.vision.cameras.shutter import poses_at
from tossid.vision.recordings.npz import read_tracks


def test_a_recording_is_shown_as_it_was(late_film: Path, content: ViewContent) -> None:
    """The tracked body follows the truth, and is drawn over its tags in both cameras, late clock or not."""
    (truth,) = read_tracks(late_film / "film" / "truth_poses.npz")
    (body,) = content.moving
    true = poses_at(truth.t, truth.q, body.t)
    assert np.median(np.linalg.norm(body.p - true[:, :3], axis=1)) < 3e-4
    assert np.rad2deg(np.median(geodesic_angle(body.quat, true[:, 3:7]))) < 0.2
    assert len(content.tosses) == 1
    assert len(body.polygons) == len(body.tags) == 6
    off: dict[str, list[float]] = {"cam0": [], "cam1": []}
    for camera in content.cameras:
        for file in content.frames[camera.name][::7]:
            found = [d for d in content.detections if d.camera == camera.name and abs(d.t - file.t_ns * 1e-9) < 1e-6]
            error = misplaced(content, camera, found) if found else None
            if error is None:
                continue
            off[camera.name].append(error)
            outlines = faces_in_view(content, camera, file.t_ns * 1e-9)
            assert 1 <= len(outlines) <= 3
            for d in found:  # each tag lies within one of the outlines
                assert any(
                    all(
                        cv2.pointPolygonTest(o.astype(np.float32), (float(x), float(y)), True) > -1
                        for x, y in d.corners
                    )
                    for o in outlines
                )
    assert all(len(errors) > 5 and np.median(errors) < 0.2 for errors in off.values())
    release = content.tosses[0].t[0]
    assert happening(content, release - 0.05) == ""
    assert happening(content, release + 0.02).endswith("flight")


def test_stages_files_are_shown_where_there_are_some(
    late_film: Path, tmp_path: Path, monkeypatch: Any, answer: Any
) -> None:
    """Their clocks too: `track` leaves them in its set-up."""
    monkeypatch.chdir(tmp_path)
    shutil.copytree(late_film / "film", tmp_path / "film")
    answer("detect", "recording=film")
    answer("track", "recording=film")
    monkeypatch.setattr("pipelines.drawing.recording_view.stages.detect", None)
    monkeypatch.setattr("pipelines.drawing.recording_view.stages.track", None)
    seen = recording_content(load("view", ViewConfig, ["recording=film"]), Console(quiet=True))
    late = {camera.name: camera.clock_offset for camera in seen.cameras}
    assert late["cam1"] - late["cam0"] == pytest.approx(0.02, abs=3e-4)
    times = [[file.t_ns * 1e-9 for file in files] for files in seen.frames.values()]
    np.testing.assert_allclose(times[0], times[1], atol=4e-4)
    (tmp_path / "film" / "cameras.yaml").touch()  # a newer recording of the same name: its stages are not there yet
    with pytest.raises(TypeError, match="NoneType"):
        recording_content(load("view", ViewConfig, ["recording=film"]), Console(quiet=True))
