"""A rolling shutter: where rows and tags lie; poses between two."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tests.vision.films import corner_rms, film_of
from tossid.objects import ObjectModel
from tossid.rotations import quat_exp, transform, transform_points
from tossid.settings.rendering import RenderSettings
from tossid.synthesis.timeline import Filming, Timeline
from tossid.vision.cameras.camera import Camera
from tossid.vision.cameras.rig import look_at
from tossid.vision.cameras.shutter import Shutter, interpolate, poses_at
from tossid.vision.detection.detect import detect_frames
from tossid.vision.rendering.render import Renderer
from tossid.vision.setup.faces import tag_corners

DT = 1 / 148


UNSEEN = np.array([0.0, 0.0, -9.0, 1.0, 0.0, 0.0, 0.0])


def _facing(width: int = 300, height: int = 240) -> Camera:
    """A camera that looks along -x at the height 0.5 m, one metre from the origin's axis."""
    T = look_at([1.0, 1e-9, 0.5], [0.0, 0.0, 0.5])
    return Camera("c", (width, height), [400, 400, (width - 1) / 2, (height - 1) / 2], T_rig_cam=T)


def test_a_rolling_shutter_shifts_rows_by_speed_times_line_time(cube: ObjectModel):
    camera, speed, line = _facing(), 2.0, 2e-5
    renderer = Renderer(cube, [camera], RenderSettings(blur=0.0, noise=0.0, ambient=1.0, samples=64))
    t = np.arange(5) * DT
    q = np.column_stack([np.zeros(5), speed * (t - t[2]), np.full(5, 0.5), np.ones(5), np.zeros((5, 3))])
    rows = np.arange(100, 140)
    empty = renderer.render(UNSEEN, UNSEEN, "c", None).astype(float)
    where = {}
    for shutter in (Shutter(0.0005), Shutter(0.0005, line)):
        image = renderer.draw(shutter.expose(t, q, 2, 240, 64), "c", None).astype(float)
        share = (image - empty) / (225.0 - empty)
        columns = np.arange(300)
        where[shutter.line] = np.array([np.average(columns, weights=share[row]) for row in rows])
    pixels_a_second = 400 * speed / (1 - 0.0524)  # the world's y is the image's x
    expected = pixels_a_second * line * (rows - 119.5)
    shift = where[line] - where[0.0]
    np.testing.assert_allclose(shift, expected, atol=0.15)  # a row's rays are few
    assert np.polyfit(rows, shift, 1)[0] == pytest.approx(pixels_a_second * line, rel=0.05)


def test_tags_lie_where_each_rows_time_puts_them(tagged: ObjectModel, timeline: Timeline, rig, tmp_path: Path):
    """Corners at the pose of their own row's time are right to a tenth of a pixel; at the frame's they are not."""
    line = 1.4e-5
    flight = slice(timeline.release[0], timeline.release[0] + 40)
    flown = Timeline(timeline.t[flight], timeline.q[flight], (), np.zeros(0), np.zeros(0))
    recording, _ = film_of(flown, tagged, rig[:2], tmp_path / "r", Filming(Shutter(0.0005, line)))
    frame, row = [], []
    for d in detect_frames(recording, tagged):
        times = d.t + line * (d.corners[:, 1] - (384 - 1) / 2)
        if times.min() < flown.t[0] or times.max() > flown.t[-1]:
            continue
        frame.append(corner_rms(d, recording, tagged, flown))
        q = poses_at(flown.t, flown.q, times)
        tag = next(tag for tag in tagged.tags if tag.id == d.tag_id)
        world = transform_points(transform(q[:, :3], q[:, 3:7]), tag_corners(tag)[:, None])[:, 0]
        row.append(np.sqrt(np.mean(np.sum((d.corners - recording.camera(d.camera).project(world)) ** 2, axis=-1))))
    fast = np.array(frame) > 0.2
    assert fast.sum() > 8
    assert np.median(np.array(row)[fast]) < 0.12
    assert np.median(np.array(row)) < 0.1
    assert np.median(np.array(frame)[fast]) > 2 * np.median(np.array(row)[fast])


def test_interpolation_takes_the_shorter_turn():
    q0 = np.array([0.0, 0, 0, 1, 0, 0, 0])
    q1 = np.array([1.0, 0, 0, *-quat_exp([0.0, 0.0, 0.4])])
    half = interpolate(q0, q1, np.array(0.5))
    np.testing.assert_allclose(half[:3], [0.5, 0, 0])
    np.testing.assert_allclose(np.abs(half[3:] @ quat_exp([0.0, 0.0, 0.2])), 1.0, atol=1e-12)
