"""Clocks that are apart are found and subtracted; clocks that agree are left alone."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.vision.sights import filmed_tumble, nees, seen, seen_over_time, tumble
from tests.vision.tracked import track
from tossid.objects import ObjectModel
from tossid.vision.cameras.rig import default_rig
from tossid.vision.pose_graph.clocks import stand_together
from tossid.vision.pose_graph.track import track_scene
from tossid.vision.recordings.registry import open_recording, recognized_format
from tossid.vision.setup.layout import Body, layout_of


@pytest.mark.parametrize("delay", [0.0405, -0.0213])
def test_a_late_clock_is_estimated_and_subtracted(tagged: ObjectModel, delay: float):
    rng, cameras = np.random.default_rng(0), default_rig()
    t, q = tumble(8 * 220, rng, rate_hz=8 * 148)
    detections = []
    for i in range(40, 200):
        for camera in cameras:
            k, off = (8 * i + 3, delay) if camera.name == "cam2" else (8 * i, 0.0)  # it also exposes in between
            detections += seen([camera], tagged, t[k] + off, q[k], rng, 0.1)
    found, report = track(detections, cameras, tagged)
    (name, (offset, sigma)) = next(iter(report.clocks.items()))
    assert list(report.clocks) == ["cam2"]
    assert offset == pytest.approx(delay, abs=max(5 * sigma, 1e-4))
    assert sigma < 1e-4
    assert name == "cam2"
    truth = q[np.clip(np.round(found.t * 8 * 148).astype(int), 0, len(q) - 1)]
    assert np.median(np.linalg.norm(found.q[:, :3] - truth[:, :3], axis=1)) < 0.3e-3
    assert np.mean(nees(found, truth)) < 1.5


def test_clocks_that_agree_are_left_alone(tagged: ObjectModel):
    cameras = default_rig()
    detections, _ = filmed_tumble(cameras, tagged, np.random.default_rng(1), n=160)
    _, report = track(detections, cameras, tagged)
    assert report.clocks == {}
    assert report.suspects == []


@pytest.mark.parametrize("known", [True, False])
@pytest.mark.parametrize(("late", "every"), [(1.3, 1), (-4.0, 5), (0.07, 1)])
def test_an_offset_of_any_size_is_estimated(tagged: ObjectModel, late: float, every: int, known: bool) -> None:
    """Of cameras at known places or not, of one rate or 148 and 30 frames a second; no sighting is lost."""
    rng, cameras = np.random.default_rng(2), default_rig(n_cameras=2)
    t, q = tumble(4 * 200, rng, rate_hz=4 * 148)
    detections = seen_over_time(cameras[0], tagged, t[::4], q[::4], rng)
    detections += seen_over_time(cameras[1], tagged, t[2 :: 4 * every], q[2 :: 4 * every], rng, late=late)
    if not known:
        cameras = (cameras[0], replace(cameras[1], T_rig_cam=None))
    found = track_scene(detections, cameras, layout_of(tagged))
    assert found.report.clocks.keys() == {"cam1"}
    offset, sigma = found.report.clocks["cam1"]
    assert offset == pytest.approx(late, abs=max(5 * sigma, 1e-4))
    assert sigma < 2e-4  # of frames that are 6.8 ms apart
    assert sum(found.report.left_out.get("cam1", {}).values()) < 0.02 * found.report.sightings["cam1"]
    track = found.tracks["cube"]
    truth = q[np.clip(np.round(track.t * 4 * 148).astype(int), 0, len(q) - 1)]
    assert np.median(np.linalg.norm(track.q[:, :3] - truth[:, :3], axis=1)) < 2e-3  # mostly by one camera alone


def test_a_camera_of_unknown_place_with_the_right_time_is_left_alone(tagged: ObjectModel) -> None:
    rng, true = np.random.default_rng(3), default_rig(n_cameras=2)
    t, q = tumble(160, rng)
    detections = [d for camera in true for d in seen_over_time(camera, tagged, t, q, rng)]
    report = track_scene(detections, (true[0], replace(true[1], T_rig_cam=None)), layout_of(tagged)).report
    assert report.clocks == report.clock_doubts == {}


def test_cameras_stand_together_on_one_rig_or_on_rigs_that_stand() -> None:
    bodies = [Body("shelf", True), Body("tripod", True), Body("drone", False)]
    a, b, c = (replace(default_rig()[0], rig_body=body.name) for body in bodies)
    assert stand_together(a, b, bodies)
    assert stand_together(c, c, bodies)
    assert not stand_together(a, c, bodies)


@pytest.mark.slow
@pytest.mark.parametrize("known", [True, False])
def test_slow_cameras_clocks_are_estimated(shared_data: Path, known: bool) -> None:
    """Of a real recording at 8 frames a second, from an offset that the coarse search has to a few milliseconds."""
    path = shared_data / "tagslam_test" / "test_15"
    entry = recognized_format(path)
    assert entry is not None
    opened = open_recording(entry.settings(path=path))
    first, last = opened.cameras
    late = [replace(d, t=d.t + 1.3) if d.camera == last.name else d for d in opened.detections]
    cameras = opened.cameras if known else (first, replace(last, T_rig_cam=None, T_rig_cam_cov=None))
    report = track_scene(late, cameras, opened.layout).report
    assert report.clocks[last.name][0] == pytest.approx(1.3, abs=1e-3)
    assert report.n_poses > 0.98 * report.n_steps
