"""`tossid info`: what is in a file or folder, and what is wrong with it."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from pipelines.cli.console import Console
from pipelines.commands.info import InfoRequest, run
from tests.motion.bouncing import bounce, tracked
from tossid.motion import covariance_source, tosses_from_tracks
from tossid.motion.sessions import find_sessions, levelled_tracks
from tossid.motion.sessions.levelling import turned_track
from tossid.objects import ObjectModel
from tossid.rotations import quat_exp
from tossid.store import Dataset, write_dataset
from tossid.types import Detection, PoseTrack
from tossid.vision.recordings.npz import write_detections, write_tracks

QUIET = Console(quiet=True)


def test_what_stages_wrote_and_a_folder(tmp_path: Path) -> None:
    corners, cov = np.zeros((4, 2)), np.tile(np.eye(2), (4, 1, 1))
    found = [Detection(camera, 0.1, tag, corners, cov, 0, 50.0) for camera, tag in (("b", 3), ("a", 3), ("a", 4))]
    write_detections(found, tmp_path / "detections.npz")
    assert run(InfoRequest(tmp_path / "detections.npz"), QUIET) == {
        "kind": "detections",
        "n_detections": 3,
        "cameras": {"a": 2, "b": 1},
        "tags": {"3": 2, "4": 1},
    }
    t, q = 0.1 * np.arange(5), np.tile([0.0, 0, 0, 1, 0, 0, 0], (5, 1))
    write_tracks([PoseTrack("cube", t, q)], tmp_path / "poses.npz")
    tracks = run(InfoRequest(tmp_path / "poses.npz"), QUIET)
    assert (tracks["tracks"], tracks["n_frames"], tracks["covariances"]) == ({"cube": 5}, 5, False)
    np.savetxt(tmp_path / "poses.txt", np.column_stack([t, q[:, :3], q[:, 4:], q[:, 3]]))
    poses = run(InfoRequest(tmp_path / "poses.txt"), QUIET)
    assert (poses["n_frames"], poses["rate_hz"], poses["duration_s"]) == (5, pytest.approx(10), pytest.approx(0.4))
    for name in ("0.pt", "a.h5"):
        (tmp_path / name).touch()
    assert run(InfoRequest(tmp_path), QUIET) == {"kind": "folder", "datasets": ["a.h5"], "pt_files": 1, "txt_files": 1}


@pytest.fixture
def two_sessions(tmp_path: Path, cube: ObjectModel) -> Path:
    """A dataset whose last twelve tosses stand in a world that is tilted by 3 degrees."""
    rng, tracks = np.random.default_rng(4), []
    for k, truth in enumerate(bounce(cube, rng, tosses=24, frames=220)):
        tilt = quat_exp(np.array([np.deg2rad(3.0), 0.0, 0.0]) * (k >= 12))
        tracks.append(turned_track(tracked(truth, rng, name=str(k), with_cov=False), tilt, 0.0))
    order = find_sessions(tracks, cube)
    tosses = tosses_from_tracks(levelled_tracks(tracks, order), cube)
    provenance = {"covariance_source": covariance_source(tracks)}
    write_dataset(Dataset(cube, tosses, 148.0, "made", provenance, order=order), tmp_path / "tilted.h5")
    return tmp_path / "tilted.h5"


def test_the_figure_shows_the_order_of_recording(two_sessions: Path) -> None:
    out = two_sessions.with_name("order.png")
    found = run(InfoRequest(two_sessions, out), QUIET)
    assert found["figure"] == str(out)
    assert [(one["first"], one["last"], one["levelled"]) for one in found["sessions"]] == [
        ("0", "11", False),
        ("12", "23", True),
    ]
    image = cv2.imread(str(out))
    assert image is not None
    assert min(image.shape[:2]) > 300
    assert np.ptp(image) > 200  # something is drawn on white
    assert "figure" not in run(InfoRequest(two_sessions), QUIET)
