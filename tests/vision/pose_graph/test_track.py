"""Tracking: the rendered toss against truth, covariances against their errors, flips, TagSLAM's poses."""

from __future__ import annotations

import numpy as np
import pytest

from tests.vision.conftest import Filmed
from tests.vision.sights import alike, motion, nees, seen
from tests.vision.tracked import track
from tossid.errors import InputError, ObjectError
from tossid.objects import JointType, ObjectModel
from tossid.rotations import (
    geodesic_angle,
    quat_exp,
    quat_mul,
)
from tossid.settings.tracking import TrackSettings
from tossid.types import Detection
from tossid.vision.cameras.rig import default_rig
from tossid.vision.detection.detect import detect_frames
from tossid.vision.setup.faces import default_tags


def test_the_rendered_recording_is_tracked_to_the_accuracy_asked_for(filmed: Filmed, tagged: ObjectModel):
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


def test_covariances_are_honest(tagged: ObjectModel):
    """NEES 1 on average, and its spread that of χ² with six degrees of freedom."""
    rng = np.random.default_rng(1)
    cameras = default_rig()
    t, q = np.arange(400) / 148, motion(400, rng)
    detections = [d for i in range(400) for d in seen(cameras, tagged, t[i], q[i], rng, 0.1)]
    found, report = track(detections, cameras, tagged)
    assert len(found.t) == 400
    errors = nees(found, q)
    assert np.mean(errors) == pytest.approx(1.0, abs=0.1)
    assert np.quantile(6 * errors, 0.95) == pytest.approx(12.59, rel=0.15)  # χ² with 6 degrees of freedom
    assert report.noise_scale == pytest.approx(1.0, abs=0.05)
    assert report.rms == pytest.approx(0.1 * np.sqrt(2), rel=0.15)


def test_a_single_frontal_tag_does_not_flip(tagged: ObjectModel):
    """One camera that sees one small tag nearly straight on: its tilt is ambiguous, neighbours must decide."""
    rng = np.random.default_rng(4)
    camera = default_rig(n_cameras=1)[0]
    one = tagged.with_changes(tags=tagged.tags[4:5])
    away = camera.T_world_cam[:3, 2]
    # start tilted, where the image decides, and sway through the view from straight ahead
    t = np.arange(120) / 148
    sway = np.deg2rad(40) * np.cos(2 * np.pi * t / t[-1])
    facing = quat_exp(np.cross([0, 0, 1.0], -away) / np.linalg.norm(np.cross([0, 0, 1.0], -away)) * np.arccos(-away[2]))
    quat = quat_mul(facing, quat_exp(sway[:, None] * [1.0, 0.0, 0.0]))
    q = np.concatenate([np.tile([0.0, 0.0, 0.3], (120, 1)), quat], axis=1)
    detections = [d for i in range(120) for d in seen([camera], one, t[i], q[i], rng, 0.3)]
    found, report = track(detections, [camera], one, settings=TrackSettings(max_sigma=0.1, max_angle_sigma=0.5))
    truth = q[np.round(found.t * 148).astype(int)]
    angle = np.rad2deg(geodesic_angle(found.q[:, 3:7], truth[:, 3:7]))
    assert angle.max() < 20.0
    assert len(found.t) > 60
    assert report.n_steps == 120


def test_nonsense_is_rejected_with_a_reason(tagged: ObjectModel):
    rng = np.random.default_rng(6)
    cameras = default_rig()
    t, q = np.arange(60) / 148, motion(60, rng)
    detections = []
    for i in range(60):
        for d in seen(cameras, tagged, t[i], q[i], rng, 0.1):
            corners = d.corners + (rng.normal(size=(4, 2)) * 8 if i in (20, 21) else 0)
            detections.append(Detection(d.camera, d.t, d.tag_id, corners, d.corner_cov))
    found, report = track(detections, cameras, tagged)
    assert len(found.t) == 58
    assert report.dropped_steps == {"reprojection": 2}


def test_what_cannot_be_tracked_is_said(tagged: ObjectModel, elbow: ObjectModel):
    cameras = default_rig()
    with pytest.raises(InputError, match="nothing to track"):
        track([], cameras, tagged)
    sliding = elbow.with_changes(tags=default_tags(elbow), joint_type=np.array([JointType.FREE, JointType.SLIDE]))
    with pytest.raises(ObjectError, match="slides"):
        track([], cameras, sliding)
    with pytest.raises(InputError, match="cam9"):
        track([Detection("cam9", 0.0, 0, np.zeros((4, 2)), alike(1.0))], cameras, tagged)
