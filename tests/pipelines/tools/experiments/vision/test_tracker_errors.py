"""A tracker without errors sees what is there, and known errors do what geometry says."""

from __future__ import annotations

import numpy as np
import pytest

from pipelines.tools.experiments.vision.tracker_errors import (
    AZIMUTHS,
    ERRORS,
    Camera,
    Error,
    Scene,
    _moved_world,
    tracked,
)
from tossid.rotations import quat_exp, quat_to_matrix


@pytest.fixture(scope="module")
def scene() -> Scene:
    rng = np.random.default_rng(2)
    n = 60
    p = np.column_stack([rng.uniform(-0.3, 0.3, (n, 2)), rng.uniform(0.05, 0.2, n)])
    return Scene(
        p, quat_to_matrix(quat_exp(rng.normal(0, 2, (n, 3)))), rng.normal(0, 1, (n, 3)), rng.normal(0, 5, (n, 3))
    )


def test_without_an_error_poses_are_true(scene: Scene) -> None:
    p, R = tracked(scene, Error("none"))
    np.testing.assert_allclose(p, scene.p, atol=1e-9)
    np.testing.assert_allclose(R, scene.R, atol=1e-8)


def test_a_tilted_world_turns_places_and_attitudes_alike(scene: Scene) -> None:
    tilt = np.array([0.5, -0.15, 0.0])
    p, R = tracked(scene, Error("tilted", camera=lambda i, camera: _moved_world(camera, tilt)))
    turn = quat_to_matrix(quat_exp(np.deg2rad(tilt)))
    np.testing.assert_allclose(p, scene.p @ turn.T, atol=1e-8)
    np.testing.assert_allclose(R, turn @ scene.R, atol=1e-7)


def test_all_clocks_late_show_a_later_pose_and_one_late_a_part_of_the_way(scene: Scene) -> None:
    late = scene.at(2e-3)
    p, R = tracked(scene, Error("late", delay=lambda i, pixels: 2e-3))
    np.testing.assert_allclose(p, late.p, atol=1e-8)
    np.testing.assert_allclose(R, late.R, atol=1e-7)
    one, _ = tracked(scene, Error("one late", delay=lambda i, pixels: 2e-3 if i == 0 else 0.0))
    share = np.linalg.norm(one - scene.p, axis=1) / np.linalg.norm(late.p - scene.p, axis=1)
    assert 0.2 < np.median(share) < 0.5  # one of three cameras


def test_focal_lengths_change_distances_and_a_filter_lags(scene: Scene) -> None:
    error = Error("focal", camera=lambda i, camera: Camera(camera.at, camera.R, 1.01 * camera.focal))
    p, _ = tracked(scene, error)
    away = scene.p - [0.0, 0.0, 0.1]
    assert np.sum((p - scene.p) * away, axis=1) / np.sum(away**2, axis=1) == pytest.approx(0.01, abs=0.01)
    (low_pass,) = [error for error in ERRORS if "low pass" in error.says]
    np.testing.assert_allclose(tracked(scene, low_pass)[0], scene.p - 5e-3 * scene.v, atol=1e-9)
    assert len(AZIMUTHS) == 3
