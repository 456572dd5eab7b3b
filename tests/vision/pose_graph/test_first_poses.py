"""First poses: one unknown pose from tags, the choice between the two of a flat tag, and all that follows from it."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace

import numpy as np
import pytest

from tests.vision.sights import filmed_tumble
from tossid.objects import ObjectModel
from tossid.rotations import (
    geodesic_angle,
    matrix_to_quat,
    quat_normalize,
    transform,
    transform_from_rotvec,
    transform_inv,
    transform_points,
)
from tossid.settings.tracking import TrackSettings
from tossid.vision.cameras.rig import default_rig
from tossid.vision.pose_graph.initial import choose, initialise
from tossid.vision.pose_graph.resect import Resection, Sightings, chi2_scale, resect, tag_poses
from tossid.vision.pose_graph.scene import observe
from tossid.vision.setup.layout import SQUARE, layout_of


def sightings(rng: np.random.Generator, n: int, m: int, sigma: float) -> tuple[Sightings, np.ndarray]:
    """m tags on each of n targets before cameras 1.5 m away; the true T_parent_target."""
    T = transform(rng.uniform(-0.1, 0.1, (n, 3)), quat_normalize(rng.normal(size=(n, 4))))
    T_parent_cam = np.eye(4)
    T_parent_cam[:3, 3] = [0.0, 0.0, -1.5]
    group = np.repeat(np.arange(n), m)
    T_cam_parent = np.broadcast_to(transform_inv(T_parent_cam), (n * m, 4, 4)).copy()
    facing = transform(
        rng.uniform(-0.05, 0.05, (n * m, 3)), quat_normalize([0.0, 1.0, 0.0, 0.0] + rng.normal(size=(n * m, 4)) / 4)
    )
    T_target_tag = transform_inv(T[group]) @ facing
    half = np.full(n * m, 0.04)
    x = transform_points(T_cam_parent @ T[group] @ T_target_tag, half[:, None, None] * SQUARE)
    seen = x[..., :2] / x[..., 2:] + sigma * rng.normal(size=(n * m, 4, 2))
    whiten = np.broadcast_to(np.eye(2) / sigma, (n * m, 4, 2, 2))
    return Sightings(group, T_cam_parent, T_target_tag, half, seen, whiten, tag_poses(seen, half)), T


def _turned(found: np.ndarray, T: np.ndarray) -> np.ndarray:
    return geodesic_angle(matrix_to_quat(T[:, :3, :3]), matrix_to_quat(found[:, :3, :3]))


def test_poses_are_found():
    s, T = sightings(np.random.default_rng(1), 200, 3, 1e-4)
    found = resect(s, 200)
    assert found.known.all()
    assert _turned(found.T[:, 0], T).max() < 0.02
    # twice a minimum of Huber's loss: χ² but for a few corners
    assert found.noise_scale() == pytest.approx(1.0, abs=0.05)


def test_one_small_tag_leaves_two_poses():
    s, T = sightings(np.random.default_rng(2), 300, 1, 5e-4)
    found = resect(s, 300)
    angle, other = (_turned(found.T[:, k], T) for k in (0, 1))
    assert np.mean(angle > 0.4) > 0.02  # some are flipped, and for those the right one is the alternative
    assert np.quantile(np.minimum(angle, other), 0.97) < 0.3
    assert (found.gain >= 0).all()


def test_a_false_tag_among_five_hardly_matters():
    s, T = sightings(np.random.default_rng(3), 20, 5, 1e-4)
    s.seen[::5] += 0.02  # a tag of each target is elsewhere
    found = resect(replace(s, T_cam_tag=tag_poses(s.seen, s.half)), 20)
    assert np.quantile(np.linalg.norm(found.T[:, 0, :3, 3] - T[:, :3, 3], axis=1), 0.9) < 0.004


def test_what_is_not_seen_has_no_pose():
    assert np.isnan(tag_poses(np.full((1, 4, 2), np.nan), np.array([0.1]))).all()


def test_unknown_cameras_are_placed_by_what_a_known_one_sees(tagged: ObjectModel) -> None:
    true = default_rig()
    detections, q = filmed_tumble(true, tagged, np.random.default_rng(0), n=60)
    cameras = (true[0], *(replace(camera, T_rig_cam=None) for camera in true[1:]))
    state = initialise(observe(detections, cameras, layout_of(tagged), dropped=Counter()))
    for c, camera in enumerate(true):
        assert np.linalg.norm(state.camera[c][:3, 3] - camera.T_rig_cam[:3, 3]) < 0.01
    T = state.world[-1]
    known = np.isfinite(T[:, 0, 0])
    assert known.mean() > 0.95
    angle = geodesic_angle(matrix_to_quat(T[known, :3, :3]), q[known, 3:7])
    assert np.quantile(angle, 0.95) < np.deg2rad(3.0)
    assert np.median(np.linalg.norm(T[known, :3, 3] - transform(q[known, :3], q[known, 3:7])[:, :3, 3], axis=1)) < 2e-3


def _two(angles: np.ndarray, flipped: np.ndarray, certain: np.ndarray) -> Resection:
    """A slow turn about x; where `flipped`, the pose with the smaller cost is the reflected one."""
    n = len(angles)
    true, other = (
        transform_from_rotvec(np.zeros((n, 3)), np.stack([a, 0 * a, 0 * a], axis=1)) for a in (angles, -angles)
    )
    first = np.where(flipped[:, None, None], other, true)
    second = np.where(flipped[:, None, None], true, other)
    cost = 2.0 * 8 - 6 + np.stack([np.zeros(n), np.where(certain, 1000.0, 1.0)], axis=1)
    return Resection(np.stack([first, second], axis=1), cost, np.ones(n, bool), np.full(n, 2))


def test_certain_neighbours_decide_between_two_poses() -> None:
    t, angles = np.arange(20) / 148, np.linspace(0.6, 0.8, 20)
    flipped = np.arange(20) % 3 == 1
    certain = ~flipped & (np.arange(20) % 3 == 0)
    T, sure = choose(_two(angles, flipped, certain), t, TrackSettings())
    assert sure.all()
    np.testing.assert_allclose(np.arctan2(T[:, 2, 1], T[:, 1, 1]), angles, atol=1e-9)
    _, sure = choose(_two(angles, flipped, certain), 10 * t, TrackSettings())  # too far apart in time
    np.testing.assert_array_equal(sure, certain)


@pytest.mark.parametrize("scale", [0.5, 3.0])
def test_the_noises_scale_is_that_of_the_residuals(scale: float) -> None:
    square = scale**2 * np.random.default_rng(1).chisquare(18, 4000)
    assert chi2_scale(square, np.full(4000, 18.0)) == pytest.approx(scale, rel=0.02)
