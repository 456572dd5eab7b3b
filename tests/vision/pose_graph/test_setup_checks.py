"""Parts of the set-up that the images contradict are reported by name."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace

import numpy as np
import pytest

from tests.vision.sights import filmed_tumble
from tests.vision.tracked import track
from tossid.errors import InputError
from tossid.objects import ObjectModel
from tossid.vision.cameras.camera import Camera
from tossid.vision.cameras.rig import default_rig
from tossid.vision.pose_graph.scene import observe
from tossid.vision.pose_graph.setup_checks import check_set_up
from tossid.vision.pose_graph.state import given
from tossid.vision.setup.layout import layout_of


def _suspects(tagged: ObjectModel, filmed: ObjectModel, cameras: tuple[Camera, ...], filming: tuple[Camera, ...]):
    detections, _ = filmed_tumble(filming, filmed, np.random.default_rng(2), n=100)
    return track(detections, cameras, tagged)[1].suspects


@pytest.mark.parametrize("moved", [1, 4])
def test_a_tag_moved_by_five_millimetres_is_reported_by_its_id(tagged: ObjectModel, moved: int):
    cameras, tags = default_rig(), list(tagged.tags)
    T = tags[moved].T_body_tag.copy()
    T[:3, 3] += T[:3, :3] @ [0.003, 0.004, 0.0]
    tags[moved] = replace(tags[moved], T_body_tag=T)
    (suspect,) = _suspects(tagged, tagged.with_changes(tags=tuple(tags)), cameras, cameras)
    assert (suspect.kind, suspect.name) == ("tag", str(moved))
    assert suspect.distance == pytest.approx(0.005, abs=0.0005)


def test_swapped_cameras_are_reported(tagged: ObjectModel):
    cameras = default_rig()
    filming = (replace(cameras[0], name="cam1"), replace(cameras[1], name="cam0"), cameras[2])
    suspects = _suspects(tagged, tagged, cameras, filming)
    assert [(suspect.kind, suspect.name) for suspect in suspects] == [("swapped", "cam0 and cam1")]


def test_a_wrong_focal_length_is_found_from_the_residuals(tagged: ObjectModel):
    cameras = default_rig()
    filming = (cameras[0], replace(cameras[1], intrinsics=cameras[1].intrinsics * [1.03, 1.03, 1, 1]), cameras[2])
    (suspect,) = _suspects(tagged, tagged, cameras, filming)
    assert (suspect.kind, suspect.name) == ("intrinsics", "cam1")
    assert "focal length (+3.0 %)" in suspect.message


def test_a_moved_camera_is_reported_even_where_no_pose_is_left(tagged: ObjectModel):
    cameras = default_rig()
    T = cameras[2].T_rig_cam.copy()
    T[:3, 3] += [0.05, 0.0, 0.0]
    with pytest.raises(InputError, match=r"camera cam2 is 50 mm and 0\.0° from where it is said to be"):
        _suspects(tagged, tagged, cameras, (cameras[0], cameras[1], replace(cameras[2], T_rig_cam=T)))


def _of_size(model: ObjectModel, factor: float, only: int | None = None) -> ObjectModel:
    """The object with tags of another size, all or one, where they were."""
    tags = (replace(tag, size=factor * tag.size) if only in (None, tag.id) else tag for tag in model.tags)
    return model.with_changes(tags=tuple(tags))


@pytest.mark.parametrize(
    ("n_cameras", "factor", "said"),
    [
        (3, 0.8, "0.80"),
        (3, 7 / 9, "0.78"),
        (3, 1.06, "1.06"),
        (3, 0.001, "0.001"),
        (2, 10.0, "10"),
        (1, 0.8, "0.80"),
        (1, 1.2, "1.20"),
        (1, 0.0254, "0.0254"),
    ],
)
def test_tags_of_another_size_than_stated_are_reported_with_the_factor(
    tagged: ObjectModel, n_cameras: int, factor: float, said: str
):
    """Stated over the white border, or in other units: what is filmed is `factor` times as large."""
    cameras = default_rig()[:n_cameras]
    detections, _ = filmed_tumble(cameras, tagged, np.random.default_rng(2), n=60)
    scene = observe(detections, cameras, layout_of(_of_size(tagged, 1 / factor)), dropped=Counter())
    (suspect,) = check_set_up(scene, given(scene))
    assert (suspect.kind, suspect.name) == ("size", tagged.body_names[0])
    assert f"appear {said} times as large as stated" in suspect.message


def test_poses_of_tags_of_another_size_come_with_the_suspicion(tagged: ObjectModel):
    suspects = _suspects(_of_size(tagged, 1.25), tagged, default_rig(), default_rig())
    assert [suspect.kind for suspect in suspects] == ["size"]


def test_one_tag_of_another_size_is_reported_by_its_id(tagged: ObjectModel):
    (suspect,) = _suspects(tagged, _of_size(tagged, 0.9, only=3), default_rig(), default_rig())
    assert (suspect.kind, suspect.name) == ("size", "3")
    assert "tag 3 on" in suspect.message
    assert "appears 0.90 times" in suspect.message


def test_ink_that_spreads_a_little_is_no_wrong_size(tagged: ObjectModel):
    assert _suspects(tagged, _of_size(tagged, 1.01), default_rig(), default_rig()) == []
