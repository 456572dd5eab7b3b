"""Cameras: projection and its inverse, and the default rig."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tossid.errors import InputError
from tossid.vision.cameras.camera import Camera
from tossid.vision.cameras.rig import default_rig

RADTAN = Camera("a", (640, 512), [600, 610, 320, 250], "radtan", [-0.2, 0.15, 0.001, -0.0004, -0.02])
FISHEYE = Camera("b", (640, 512), [300, 310, 320, 250], "equidistant", [-0.02, 0.01, 0.001, -0.0004])


def _points(n: int = 300) -> np.ndarray:
    return np.random.default_rng(0).uniform([-0.5, -0.4, 0.8], [0.5, 0.4, 2.0], (n, 3))


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
def test_pixels_follow_the_lens_models_equation(camera: Camera, model: Callable[..., list[np.ndarray]]):
    x, y, z = _points().T
    expected = camera.intrinsics[:2] * np.stack(model(x / z, y / z, camera.distortion), -1) + camera.intrinsics[2:]
    np.testing.assert_allclose(camera.distort(_points())[0], expected, atol=1e-9)


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
def test_what_is_no_camera_is_refused(change: dict, words: str):
    with pytest.raises(InputError, match=words):
        Camera(**{"name": "c", "resolution": (640, 480), "intrinsics": [600, 600, 320, 240], **change})


def test_the_default_rig_sees_the_whole_area():
    turn = np.linspace(0, 2 * np.pi, 40)
    for camera in default_rig(area=1.0, height=0.4):
        for z in (0.0, 0.4):
            points = np.column_stack([0.5 * np.cos(turn), 0.5 * np.sin(turn), np.full(40, z)])
            assert camera.contains(camera.project(points)).all()
