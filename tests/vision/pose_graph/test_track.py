"""Tracks against truth and against TagSLAM's: errors, covariances that are as large as these, flips, hinges."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.vision.conftest import Filmed
from tests.vision.sights import alike, apart, motion, nees, sights, tangent, track
from tossid.errors import InputError, ObjectError
from tossid.objects import JointType, ObjectModel
from tossid.rotations import geodesic_angle, quat_boxminus, quat_exp, quat_mul, transform, xyzw_to_wxyz
from tossid.settings.tracking import TrackSettings
from tossid.types import Detection
from tossid.vision.cameras.camera import Camera
from tossid.vision.cameras.rig import default_rig
from tossid.vision.detection.detect import detect_frames
from tossid.vision.pose_graph.track import track_scene
from tossid.vision.recordings.bag_contents import read_bag_detections
from tossid.vision.setup.calibration import read_cameras
from tossid.vision.setup.faces import default_tags
from tossid.vision.setup.layout import Body, TagLayout, layout_of
from tossid.vision.setup.tagslam import read_tagslam

EVERYTHING = TrackSettings(max_sigma=np.inf, max_angle_sigma=np.inf)


def _sights(
    cameras: Sequence[Camera], model: ObjectModel, q: np.ndarray, rng: np.random.Generator, sigma: float = 0.1
) -> list[Detection]:
    return list(sights(cameras, model, np.arange(len(q)) / 148, q, rng, sigma=sigma))


def test_the_rendered_recording_is_tracked_to_the_accuracy_asked_for(filmed: Filmed, tagged: ObjectModel) -> None:
    detections = list(detect_frames(filmed.recording, tagged))
    found, report = track(detections, filmed.recording.cameras, tagged)
    index = np.round((found.t - filmed.timeline.t[0]) * 148).astype(int)
    np.testing.assert_allclose(found.t, filmed.timeline.t[index], atol=1e-6)
    q = filmed.timeline.q[index]
    position = np.linalg.norm(found.q[:, :3] - q[:, :3], axis=1)
    angle = np.rad2deg(geodesic_angle(found.q[:, 3:7], q[:, 3:7]))
    assert len(found.t) >= 0.98 * len(filmed.timeline.t)
    assert np.median(position) < 0.2e-3  # asked for: 0.5 mm and 0.3 degrees
    assert np.median(angle) < 0.15
    assert np.quantile(position, 0.95) < 0.6e-3
    assert angle.max() < 5.0
    assert 0.5 < np.mean(nees(found, q)) < 1.6
    assert report.n_poses == len(found.t)
    assert report.n_steps - report.n_poses == sum(report.dropped_steps.values())
    assert report.rms < 0.3
    assert set(report.rms_by_camera) == {"cam0", "cam1", "cam2"}


def test_covariances_are_honest_and_nonsense_is_rejected(tagged: ObjectModel) -> None:
    """NEES 1 on average, and its spread that of χ² with six degrees of freedom; two frames show nonsense."""
    rng, cameras = np.random.default_rng(1), default_rig()
    q = motion(400, rng)
    detections = [
        replace(d, corners=d.corners + rng.normal(size=(4, 2)) * 8) if round(d.t * 148) in (20, 21) else d
        for d in _sights(cameras, tagged, q, rng)
    ]
    found, report = track(detections, cameras, tagged)
    assert report.dropped_steps == {"reprojection": 2}
    errors = nees(found, np.delete(q, [20, 21], axis=0))
    assert np.mean(errors) == pytest.approx(1.0, abs=0.1)
    assert np.quantile(6 * errors, 0.95) == pytest.approx(12.59, rel=0.15)  # χ² with 6 degrees of freedom
    assert report.noise_scale == pytest.approx(1.0, abs=0.05)


def test_a_single_frontal_tag_does_not_flip(tagged: ObjectModel) -> None:
    """One camera that sees one small tag nearly straight on: its tilt is ambiguous, neighbours must decide."""
    rng = np.random.default_rng(4)
    camera = default_rig(n_cameras=1)[0]
    one = tagged.with_changes(tags=tagged.tags[4:5])
    away = camera.T_world_cam[:3, 2]
    # start tilted, where the image decides, and sway through the view from straight ahead
    sway = np.deg2rad(40) * np.cos(np.linspace(0, 2 * np.pi, 120))
    facing = quat_exp(np.cross([0, 0, 1.0], -away) / np.linalg.norm(np.cross([0, 0, 1.0], -away)) * np.arccos(-away[2]))
    quat = quat_mul(facing, quat_exp(sway[:, None] * [1.0, 0.0, 0.0]))
    q = np.concatenate([np.tile([0.0, 0.0, 0.3], (120, 1)), quat], axis=1)
    settings = TrackSettings(max_sigma=0.1, max_angle_sigma=0.5)
    found, report = track(_sights((camera,), one, q, rng, 0.3), [camera], one, settings=settings)
    truth = q[np.round(found.t * 148).astype(int)]
    assert np.rad2deg(geodesic_angle(found.q[:, 3:7], truth[:, 3:7])).max() < 20.0
    assert len(found.t) > 60
    assert report.n_steps == 120


def test_what_cannot_be_tracked_is_said(tagged: ObjectModel, elbow: ObjectModel) -> None:
    cameras, one = default_rig(), Detection("cam0", 0.0, 300, np.zeros((4, 2)), alike(1.0))
    sliding = elbow.with_changes(tags=default_tags(elbow), joint_type=np.array([JointType.FREE, JointType.SLIDE]))
    with pytest.raises(ObjectError, match="slides"):
        track([], cameras, sliding)
    layout = layout_of(tagged)
    for detections, rig, scene, says in (
        ([], cameras, layout, "nothing to track"),
        ([replace(one, camera="cam9")], cameras, layout, "cam9"),
        ([one], cameras, TagLayout((Body("lab", True, np.eye(4)),)), "'rig', which is no body"),
        ([one], cameras, replace(layout, default_body="rig"), "no default_tag_size"),
    ):
        with pytest.raises(InputError, match=says):
            track_scene(detections, rig, scene)


# ---------------------------------------------------------------- bodies on hinges


@pytest.fixture(scope="module")
def tagged_elbow(elbow: ObjectModel) -> ObjectModel:
    return elbow.with_changes(tags=default_tags(elbow))


def test_an_articulated_object_is_tracked_with_honest_covariances(tagged_elbow: ObjectModel) -> None:
    """Poses and an angle beyond half a turn; steps in which one link is out of sight are left out."""
    rng, cameras = np.random.default_rng(3), default_rig()
    q = np.concatenate([motion(120, rng), np.linspace(2.5, 4.0, 120)[:, None]], axis=1)
    second = {tag.id for tag in tagged_elbow.tags if tag.body == 1}
    whole = _sights(cameras, tagged_elbow, q, rng)
    found, report = track(
        [d for d in whole if not (d.tag_id in second and 10 <= round(d.t * 148) < 15)], cameras, tagged_elbow
    )
    assert report.dropped_steps == {"a body out of sight": 5}
    q = np.delete(q, range(10, 15), axis=0)
    assert found.q.shape == q.shape
    assert np.abs(np.diff(found.q[:, 7])).max() < 0.1
    error = tangent(found, q)
    assert np.rad2deg(np.median(np.abs(error[:, 6]))) < 0.1
    assert np.mean(nees(found, q)) == pytest.approx(1.0, abs=0.12)
    assert np.mean(error[:, 6] ** 2 / found.q_cov[:, 6, 6]) == pytest.approx(1.0, abs=0.3)


def test_a_hinge_reduces_errors_of_single_bodies(tagged_elbow: ObjectModel) -> None:
    """One camera, small tags: bodies on their own flip or wander where the hinge keeps them together."""
    rng, camera = np.random.default_rng(5), default_rig(n_cameras=1)
    moved = motion(100, rng)
    q = np.concatenate([moved, 0.8 * np.sin(np.linspace(0, 9, 100) + rng.uniform(0, 6))[:, None]], axis=1)
    detections = _sights(camera, tagged_elbow, q, rng, 0.3)
    loose = TrackSettings(max_sigma=0.1, max_angle_sigma=1.0)
    found, _ = track(detections, camera, tagged_elbow, settings=loose)
    error = np.rad2deg(np.linalg.norm(tangent(found, q[np.round(found.t * 148).astype(int)])[:, 3:6], axis=1))
    assert len(found.t) >= 95
    assert error.max() < 10.0
    base = track_scene(detections, camera, layout_of(tagged_elbow), settings=loose).tracks["elbow_1"]
    turn = quat_boxminus(base.q[:, 3:7], q[np.round(base.t * 148).astype(int), 3:7])
    assert np.median(error) < 0.7 * np.rad2deg(np.median(np.linalg.norm(turn, axis=1)))


# ---------------------------------------------------------------- TagSLAM's published recordings


def _recording(shared_data: Path, test: int) -> tuple[list[Detection], tuple[Camera, ...], TagLayout]:
    folder = shared_data / "tagslam_test" / f"test_{test}"
    layout = read_tagslam(folder / "tagslam.yaml")
    cameras = read_cameras(folder, layout=layout)
    return list(read_bag_detections(folder, cameras, sigma=1.0).detections), cameras, layout


@pytest.mark.parametrize(
    ("test", "body", "distance", "angle"),
    [(16, "cam_rig", 0.5, 0.01), (17, "cam_rig", 0.5, 0.01), (4, "wand", 1.0, 0.03), (23, "tag_board", 1.0, 0.03)],
)
def test_poses_are_tagslams(shared_data: Path, test: int, body: str, distance: float, angle: float) -> None:
    """Every pose that TagSLAM has of its own recordings, from its own set-up and bag."""
    tracked = track_scene(*_recording(shared_data, test), settings=EVERYTHING)
    with (shared_data / "tagslam_test" / f"test_{test}" / "reference_poses.csv").open() as stream:
        rows = list(csv.DictReader(stream))
    found, errors = tracked.tracks[body], []
    for row in rows:
        i = int(np.argmin(np.abs(found.t - int(row["t_ns"]) * 1e-9)))
        assert abs(found.t[i] - int(row["t_ns"]) * 1e-9) < 1e-5
        quat = xyzw_to_wxyz([float(row[f"q{k}"]) for k in "xyzw"])
        expected = transform(np.array([float(row[k]) for k in "xyz"]), quat)
        errors.append(apart(transform(found.q[i, :3], found.q[i, 3:7]), expected))
    assert (np.median(errors, axis=0) < [distance, angle]).all()


def test_the_real_tumbling_cube_is_never_lost(shared_data: Path) -> None:
    """18 tags, two cameras: a pose in every frame that shows a tag, no jump, and 0.6 px with the tags as they are
    printed and their edges spread (docs/results/vision.md)."""
    detections, cameras, layout = _recording(shared_data, 15)
    tracked = track_scene(detections, cameras, layout, settings=EVERYTHING)
    found = tracked.tracks["cube"]
    assert len(found.t) == len({d.t for d in detections})
    assert tracked.report.rms < 0.6 < tracked.report.rms_bare < 1.0
    assert len(tracked.report.prints) == 17
    assert (np.linalg.norm(np.diff(found.q[:, :3], axis=0), axis=1) / np.diff(found.t)).max() < 1.5
    assert tracked.report.unplaced == []
