"""Detections sorted into a scene: time steps, merged rows, what is left out, and how corners move as edges spread."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace

import numpy as np
import pytest

from tests.vision.pose_graph.walls import wall
from tests.vision.sights import filmed_tumble
from tossid.objects import ObjectModel
from tossid.vision.cameras.rig import default_rig
from tossid.vision.pose_graph.scene import corner_growth, gap, observe, swapped, time_steps
from tossid.vision.pose_graph.track import track_scene
from tossid.vision.setup.layout import Body, Remap, Squash, layout_of


def test_a_static_camera_sees_a_static_tag_once():
    """Merged sightings give what all of them would, and a tag that did move is not merged."""
    detections, cameras, layout = wall(np.random.default_rng(6), noise=0.3)
    first = [replace(d, t=k / 10) for k in range(20) for d in detections[:4]]
    rng = np.random.default_rng(7)
    first = [replace(d, corners=d.corners + 0.3 * rng.normal(size=(4, 2))) for d in first]
    static = replace(layout, bodies=(layout.bodies[0], Body("rig", True)))
    scene = observe(first, cameras, static, dropped=Counter())
    assert len(scene.step) == 4
    np.testing.assert_array_equal(scene.count, 20)
    mean = np.mean([d.corners for d in first if d.tag_id == 2], axis=0)
    np.testing.assert_allclose(scene.pixels[2], mean, atol=1e-9)
    bumped = [replace(d, corners=d.corners + 40 * (d.t > 1.0) * (d.tag_id == 3)) for d in first]
    assert len(observe(bumped, cameras, static, dropped=Counter()).step) == 3 + 20


def test_what_is_left_out_is_counted(tagged: ObjectModel):
    cameras = default_rig()
    detections, _ = filmed_tumble(cameras, tagged, np.random.default_rng(8), n=40)
    more = [*detections, replace(detections[0], corners=detections[0].corners + 30), replace(detections[1], tag_id=77)]
    more.append(replace(detections[2], corners=np.full((4, 2), np.nan)))
    out, away = (Counter(d.tag_id for d in detections if d.camera == "cam1" or k).most_common(2)[k][0] for k in (0, 1))
    layout = replace(
        layout_of(tagged),
        squashes=(Squash(frozenset({out}), None, "cam1"),),
        remaps=(Remap(away, 55, 0.0, 0.1),),
        max_hamming=1,
    )
    more.append(replace(detections[3], t=9.0, hamming=2))
    dropped = track_scene(more, cameras, layout).report.dropped_tags
    squashed = sum(d.tag_id == out and d.camera == "cam1" for d in more)
    remapped = sum(d.tag_id == away and d.t <= 0.1 for d in more)
    assert dropped["squashed"] == squashed
    assert dropped["id on no body"] == remapped + 1
    assert dropped["id seen twice in a frame"] >= 2
    assert dropped["too many corrected bits"] == 1
    assert "corners or covariance not finite" not in dropped  # it was one of two, neither to be accepted


def test_frames_within_half_a_period_are_one_step() -> None:
    """Two cameras of 100 Hz, 2 ms apart, and one of 50 Hz between them."""
    t = np.concatenate([np.arange(6) / 100, np.arange(6) / 100 + 0.002, np.arange(3) / 50 + 0.001])
    camera = np.repeat([0, 1, 2], [6, 6, 3])
    order = np.argsort(t, kind="stable")
    step, times = time_steps(t[order], camera[order])
    np.testing.assert_allclose(times, np.arange(6) / 100)
    np.testing.assert_array_equal(np.bincount(step), [3, 2, 3, 2, 3, 2])


@pytest.mark.parametrize("turn", [0.0, 0.7])
def test_corners_of_a_square_grow_along_its_diagonals(turn: float) -> None:
    R = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    square = 30 * np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]]) @ R.T
    np.testing.assert_allclose(corner_growth(square[None])[0], square / 30, atol=1e-12)


def test_swapping_cameras_twice_changes_nothing(tagged: ObjectModel) -> None:
    cameras = default_rig()
    detections, _ = filmed_tumble(cameras, tagged, np.random.default_rng(0), n=4)
    scene = observe(detections, cameras, layout_of(tagged), dropped=Counter())
    once = swapped(scene, 0, 1)
    assert not np.allclose(once.seen, scene.seen)
    twice = swapped(once, 0, 1)
    for name in ("camera", "seen", "to_pixels", "whiten", "edge_growth", "T_cam_tag"):
        np.testing.assert_allclose(getattr(twice, name), getattr(scene, name), rtol=1e-9, atol=1e-12)


def test_a_slow_cameras_frame_time_is_no_gap() -> None:
    assert gap(np.arange(20) / 148, 0.06) == 0.06
    slow = gap(np.arange(20) / 8, 0.06)
    assert 1 / 8 < slow < 2 / 8
    assert gap(np.zeros(1), 0.06) == 0.06
