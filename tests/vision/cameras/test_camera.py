"""Cameras: projection and its inverse, and the default rig."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tossid.errors import InputError
from tossid.vision.cameras._undistort import undistort_brown
from tossid.vision.cameras.camera import Camera
from tossid.vision.cameras.rig import default_rig

RADTAN = Camera("a", (640, 512), [600, 610, 320, 250], "radtan", [-0.2, 0.15, 0.001, -0.0004, -0.02])
FISHEYE = Camera("b", (640, 512), [300, 310, 320, 250], "equidistant", [-0.02, 0.01, 0.001, -0.0004])


def _points(n: int = 300) -> np.ndarray:
    return np.random.default_rng(0).uniform([-0.5, -0.4, 0.8], [0.5, 0.4, 2.0], (n, 3))


def test_radtan_projects_as_opencv_does():
    pixels, _ = RADTAN.distort(_points())
    expected = cv2.projectPoints(_points(), np.zeros(3), np.zeros(3), RADTAN.matrix, RADTAN.distortion)[0][:, 0]
    np.testing.assert_allclose(pixels, expected, atol=1e-9)


def test_equidistant_projects_as_opencv_does():
    pixels, _ = FISHEYE.distort(_points())
    points = _points()[:, None]
    expected = cv2.fisheye.projectPoints(points, np.zeros(3), np.zeros(3), FISHEYE.matrix, FISHEYE.distortion)[0][:, 0]
    np.testing.assert_allclose(pixels, expected, atol=1e-9)


@pytest.mark.parametrize("camera", [RADTAN, FISHEYE], ids=["radtan", "equidistant"])
def test_the_jacobian_is_the_derivative(camera: Camera):
    points, h = np.concatenate([_points(50), [[1e-10, -2e-10, 1.2], [0.0, 0.3, 1.0]]]), 1e-6
    _, J = camera.distort(points)
    numeric = np.stack(
        [(camera.distort(points + h * e)[0] - camera.distort(points - h * e)[0]) / (2 * h) for e in np.eye(3)], axis=-1
    )
    np.testing.assert_allclose(J, numeric, atol=1e-6 * np.abs(numeric).max())


@pytest.mark.parametrize("camera", [RADTAN, FISHEYE], ids=["radtan", "equidistant"])
@settings(max_examples=60, deadline=None)
@given(x=st.floats(-0.7, 0.7), y=st.floats(-0.7, 0.7))
def test_undistort_inverts_distort(camera: Camera, x: float, y: float):
    pixels, _ = camera.distort([x, y, 1.0])
    np.testing.assert_allclose(camera.undistort(pixels), [x, y], atol=1e-10)


@pytest.mark.parametrize("camera", [RADTAN, FISHEYE], ids=["radtan", "equidistant"])
def test_the_table_of_rays_agrees_with_the_lens_model(camera: Camera):
    assert camera.rays.shape == (513, 641, 2)
    expected = camera.undistort([[99.5, 199.5], [-0.5, -0.5], [639.5, 511.5]])
    np.testing.assert_allclose(camera.rays[[200, 0, 512], [100, 0, 640]], expected, atol=1e-12)


def test_points_that_no_pixel_shows_are_nan():
    pixels, J = RADTAN.distort([[0.0, 0.0, -1.0], [0.0, 0.0, 0.0], [0.1, 0.0, 1.0]])
    assert np.isnan(pixels[:2]).all()
    assert np.isnan(J[:2]).all()
    assert np.isfinite(pixels[2]).all()


def test_a_folded_lens_model_ends_where_it_folds():
    # r (1 - r²/3): highest at r = 1, after which farther points would come back into the image
    folded = Camera("f", (640, 480), [300, 300, 320, 240], "radtan", [-1 / 3, 0, 0, 0])
    assert folded.radius_limit == pytest.approx(1.0)
    assert np.isnan(folded.distort([1.2, 0.0, 1.0])[0]).all()
    np.testing.assert_allclose(folded.undistort(folded.distort([0.9, 0.0, 1.0])[0]), [0.9, 0.0], atol=1e-9)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"distortion_model": "fov"}, "fov"),
        ({"distortion": [0.1, 0.2]}, "coefficients"),
        ({"intrinsics": [600, -1, 0, 0]}, "intrinsics"),
        ({"distortion_model": "equidistant", "distortion": [0.1] * 5}, "equidistant takes 4"),
    ],
)
def test_what_is_no_camera_is_refused(change: dict, words: str):
    with pytest.raises(InputError, match=words):
        Camera(**{"name": "c", "resolution": (640, 480), "intrinsics": [600, 600, 320, 240], **change})


K = (-0.3, 0.1, 0.001, -0.0005, -0.02)


def _distorted(xy: np.ndarray) -> np.ndarray:
    """Brown 1966."""
    k1, k2, p1, p2, k3 = K
    x, y = xy.T
    r2 = x * x + y * y
    radial = 1 + k1 * r2 + k2 * r2**2 + k3 * r2**3
    return np.stack(
        [x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x), y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y], -1
    )


def test_undistorted_points_distort_to_their_target() -> None:
    xy = np.random.default_rng(0).uniform(-0.7, 0.7, (500, 2))
    np.testing.assert_allclose(undistort_brown(_distorted(xy), K, 2.0), xy, atol=1e-10)


def test_points_beyond_the_limit_are_nan() -> None:
    xy = np.array([[0.2, 0.0], [0.9, 0.0]])
    assert np.isnan(undistort_brown(_distorted(xy), K, 0.5)).all(axis=1).tolist() == [False, True]


def test_the_default_rig_sees_the_whole_area():
    turn = np.linspace(0, 2 * np.pi, 40)
    for camera in default_rig(area=1.0, height=0.4):
        for z in (0.0, 0.4):
            points = np.column_stack([0.5 * np.cos(turn), 0.5 * np.sin(turn), np.full(40, z)])
            assert camera.contains(camera.project(points)).all()
