"""Clocks that are apart are estimated; what of the set-up is wrong is told, by name."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.vision.sights import filmed_tumble, nees, seen, tumble
from tossid.errors import InputError
from tossid.objects import ObjectModel
from tossid.vision.camera import Camera
from tossid.vision.rig import default_rig
from tossid.vision.track import track


@pytest.mark.parametrize("late", [0.0405, -0.0213])
def test_a_late_clock_is_estimated_and_taken_off(tagged: ObjectModel, late: float):
    rng, cameras = np.random.default_rng(0), default_rig()
    t, q = tumble(8 * 220, rng, rate_hz=8 * 148)
    detections = []
    for i in range(40, 200):
        for camera in cameras:
            k, off = (8 * i + 3, late) if camera.name == "cam2" else (8 * i, 0.0)  # it also exposes in between
            detections += seen([camera], tagged, t[k] + off, q[k], rng, 0.1)
    found, report = track(detections, cameras, tagged)
    (name, (offset, sigma)) = next(iter(report.clocks.items()))
    assert list(report.clocks) == ["cam2"]
    assert offset == pytest.approx(late, abs=max(5 * sigma, 1e-4))
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


def _suspects(tagged: ObjectModel, filmed: ObjectModel, cameras: tuple[Camera, ...], filming: tuple[Camera, ...]):
    detections, _ = filmed_tumble(filming, filmed, np.random.default_rng(2), n=160)
    return track(detections, cameras, tagged)[1].suspects


@pytest.mark.parametrize("moved", [1, 4])
def test_a_tag_moved_by_five_millimetres_is_told_by_its_id(tagged: ObjectModel, moved: int):
    cameras, tags = default_rig(), list(tagged.tags)
    T = tags[moved].T_body_tag.copy()
    T[:3, 3] += T[:3, :3] @ [0.003, 0.004, 0.0]
    tags[moved] = replace(tags[moved], T_body_tag=T)
    (suspect,) = _suspects(tagged, tagged.with_changes(tags=tuple(tags)), cameras, cameras)
    assert (suspect.kind, suspect.name) == ("tag", str(moved))
    assert suspect.distance == pytest.approx(0.005, abs=0.0005)


def test_swapped_cameras_are_told(tagged: ObjectModel):
    cameras = default_rig()
    filming = (replace(cameras[0], name="cam1"), replace(cameras[1], name="cam0"), cameras[2])
    suspects = _suspects(tagged, tagged, cameras, filming)
    assert [(suspect.kind, suspect.name) for suspect in suspects] == [("swapped", "cam0 and cam1")]


def test_a_wrong_focal_length_is_told_from_the_residuals(tagged: ObjectModel):
    cameras = default_rig()
    filming = (cameras[0], replace(cameras[1], intrinsics=cameras[1].intrinsics * [1.03, 1.03, 1, 1]), cameras[2])
    (suspect,) = _suspects(tagged, tagged, cameras, filming)
    assert (suspect.kind, suspect.name) == ("intrinsics", "cam1")
    assert "focal length (+3.0 %)" in suspect.message


def test_a_moved_camera_is_told_even_where_no_pose_is_left(tagged: ObjectModel):
    cameras = default_rig()
    T = cameras[2].T_rig_cam.copy()
    T[:3, 3] += [0.05, 0.0, 0.0]
    with pytest.raises(InputError, match=r"camera cam2 is 50 mm and 0\.0° from where it is said to be"):
        _suspects(tagged, tagged, cameras, (cameras[0], cameras[1], replace(cameras[2], T_rig_cam=T)))
