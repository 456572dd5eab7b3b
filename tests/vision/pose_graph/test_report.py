"""Reports: reprojection by frame, by hand; calibrated poses replace unknown ones and keep their uncertainty."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace

import numpy as np

from tests.vision.sights import filmed_tumble
from tossid.objects import ObjectModel
from tossid.vision.cameras.rig import default_rig
from tossid.vision.pose_graph.initial import given
from tossid.vision.pose_graph.report import frame_errors
from tossid.vision.pose_graph.reprojection import reproject
from tossid.vision.pose_graph.scene import observe
from tossid.vision.pose_graph.track import track_scene
from tossid.vision.setup.layout import layout_of


def test_a_frames_rms_is_over_its_tags(tagged: ObjectModel) -> None:
    detections, _ = filmed_tumble(default_rig(), tagged, np.random.default_rng(0), n=5)
    scene = observe(detections, default_rig(), layout_of(tagged), dropped=Counter())
    errors = replace(reproject(scene, given(scene)), pixels=np.arange(1.0, len(scene.step) + 1))
    frames = frame_errors(scene, errors, np.ones(len(scene.step), dtype=bool))
    assert frames.tags.sum() == len(scene.step)
    for t, c, rms, tags in zip(frames.t, frames.camera, frames.rms, frames.tags, strict=True):
        rows = (scene.t[scene.step] + scene.delay == t) & (scene.camera == c)
        assert tags == rows.sum()
        assert rms == np.sqrt(np.mean(errors.pixels[rows] ** 2))


def test_a_calibrated_camera_has_a_pose_and_a_covariance(tagged: ObjectModel) -> None:
    true = default_rig()
    detections, _ = filmed_tumble(true, tagged, np.random.default_rng(1), n=60)
    cameras = (*true[:2], replace(true[2], T_rig_cam=None))
    tracked = track_scene(detections, cameras, layout_of(tagged))
    first, _, found = tracked.cameras
    assert first.T_rig_cam_cov is None  # exactly given
    assert found.T_rig_cam is not None
    assert found.T_rig_cam_cov is not None
    change = tracked.report.cameras[found.name]
    assert (change.distance, change.angle) == (None, None)  # none was given
    assert np.linalg.norm(found.T_rig_cam[:3, 3] - true[2].T_rig_cam[:3, 3]) < 5 * change.sigma
    assert set(tracked.report.cameras) == {found.name}
    assert tracked.report.n_steps == tracked.report.n_poses + sum(tracked.report.dropped_steps.values())
