"""Cameras: lens models against their equations, their inverses and derivatives, and rows that follow each other."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from tests.vision.films import corner_rms, film_of
from tossid.errors import InputError
from tossid.objects import ObjectModel
from tossid.rotations import quat_exp, transform, transform_points
from tossid.synthesis.timeline import Filming, Timeline
from tossid.vision.cameras.camera import Camera
from tossid.vision.cameras.rig import default_rig
from tossid.vision.cameras.shutter import Shutter, interpolate, poses_at
from tossid.vision.detection.detect import detect_frames
from tossid.vision.setup.faces import tag_corners

RADTAN = Camera("a", (640, 512), [600, 610, 320, 250], "radtan", [-0.2, 0.15, 0.001, -0.0004, -0.02])
FISHEYE = Camera("b", (640, 512), [300, 310, 320, 250], "equidistant", [-0.02, 0.01, 0.001, -0.0004])


def _brown(x: np.ndarray, y: np.ndarray, k: np.ndarray) -> list[np.ndarray]:
    """Brown 1966."""
    k1, k2, p1, p2, k3 = k
    r2 = x * x + y * y
    radial = 1 + k1 * r2 + k2 * r2**2 + k3 * r2**3
    return [x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x), y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y]


def _kannala(x: np.ndarray, y: np.ndarray, k: np.ndarray) -> list[np.ndarray]:
    """Kannala and Brandt 2006."""
    r = np.hypot(x, y)
    theta = np.arctan(r)
    distorted = theta * (1 + sum(k[i] * theta ** (2 * i + 2) for i in range(4)))
    return [x * distorted / r, y * distorted / r]


@pytest.mark.parametrize(("camera", "model"), [(RADTAN, _brown), (FISHEYE, _kannala)], ids=["radtan", "equidistant"])
def test_pixels_follow_the_lens_models_equation(camera: Camera, model: Callable[..., list[np.ndarray]]) -> None:
    """With their derivative, their inverse, and the table of the rays of pixels' corners."""
    points = np.random.default_rng(0).uniform([-0.5, -0.4, 0.8], [0.5, 0.4, 2.0], (300, 3))
    x, y, z = points.T
    pixels, _ = camera.distort(points)
    expected = camera.intrinsics[:2] * np.stack(model(x / z, y / z, camera.distortion), -1) + camera.intrinsics[2:]
    np.testing.assert_allclose(pixels, expected, atol=1e-9)
    np.testing.assert_allclose(camera.undistort(pixels), points[:, :2] / points[:, 2:], atol=1e-10)
    points, h = np.concatenate([points, [[1e-10, -2e-10, 1.2], [0.0, 0.3, 1.0]]]), 1e-6
    _, J = camera.distort(points)
    numeric = np.stack(
        [(camera.distort(points + h * e)[0] - camera.distort(points - h * e)[0]) / (2 * h) for e in np.eye(3)], axis=-1
    )
    np.testing.assert_allclose(J, numeric, atol=1e-6 * np.abs(numeric).max())
    assert camera.rays.shape == (513, 641, 2)
    rays = camera.undistort([[99.5, 199.5], [-0.5, -0.5], [639.5, 511.5]])
    np.testing.assert_allclose(camera.rays[[200, 0, 512], [100, 0, 640]], rays, atol=1e-12)


def test_points_that_no_pixel_shows_are_nan() -> None:
    pixels, J = RADTAN.distort([[0.0, 0.0, -1.0], [0.0, 0.0, 0.0], [0.1, 0.0, 1.0]])
    np.testing.assert_array_equal(np.isnan(pixels).all(axis=1), [True, True, False])
    assert np.isnan(J[:2]).all()
    # r (1 - r²/3): highest at r = 1, after which farther points would come back into the image
    folded = Camera("f", (640, 480), [300, 300, 320, 240], "radtan", [-1 / 3, 0, 0, 0])
    assert folded.radius_limit == pytest.approx(1.0)
    assert np.isnan(folded.distort([1.2, 0.0, 1.0])[0]).all()
    np.testing.assert_allclose(folded.undistort(folded.distort([0.9, 0.0, 1.0])[0]), [0.9, 0.0], atol=1e-9)
    assert np.isnan(folded.undistort([[320.0 + 300 * 0.7, 240.0]])).all()  # farther than any point comes


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"distortion_model": "fov"}, "fov"),
        ({"distortion": [0.1, 0.2]}, "coefficients"),
        ({"intrinsics": [600, -1, 0, 0]}, "intrinsics"),
        ({"distortion_model": "equidistant", "distortion": [0.1] * 5}, "equidistant takes 4"),
    ],
)
def test_what_is_no_camera_is_refused(change: dict[str, object], words: str) -> None:
    with pytest.raises(InputError, match=words):
        Camera(**{"name": "c", "resolution": (640, 480), "intrinsics": [600, 600, 320, 240], **change})


def test_the_default_rig_sees_the_whole_area() -> None:
    turn = np.linspace(0, 2 * np.pi, 40)
    for camera in default_rig(area=1.0, height=0.4):
        for z in (0.0, 0.4):
            points = np.column_stack([0.5 * np.cos(turn), 0.5 * np.sin(turn), np.full(40, z)])
            assert camera.contains(camera.project(points)).all()


def test_tags_lie_where_each_rows_time_puts_them(
    tagged: ObjectModel, timeline: Timeline, rig: tuple[Camera, ...], tmp_path: Path
) -> None:
    """Under a rolling shutter corners at the pose of their own row's time are right to a tenth of a pixel; at the
    frame's they are not."""
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


def test_interpolation_takes_the_shorter_turn() -> None:
    q0 = np.array([0.0, 0, 0, 1, 0, 0, 0])
    q1 = np.array([1.0, 0, 0, *-quat_exp([0.0, 0.0, 0.4])])
    half = interpolate(q0, q1, np.array(0.5))
    np.testing.assert_allclose(half[:3], [0.5, 0, 0])
    np.testing.assert_allclose(np.abs(half[3:] @ quat_exp([0.0, 0.0, 0.2])), 1.0, atol=1e-12)
