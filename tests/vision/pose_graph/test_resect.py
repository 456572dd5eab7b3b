"""One unknown pose from tags: the derivative, the truth recovered, the reflected tilt kept as an alternative."""

from __future__ import annotations

from dataclasses import fields, replace

import numpy as np
import pytest

from tossid.rotations import geodesic_angle, matrix_to_quat, quat_normalize, transform, transform_inv, transform_points
from tossid.settings.tracking import ResectionSettings
from tossid.vision.pose_graph.resect import Sightings, resect, residuals, retract, tag_poses
from tossid.vision.setup.layout import SQUARE


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


def test_the_jacobian_is_the_derivative():
    s, T = sightings(np.random.default_rng(0), 3, 2, 1e-4)
    _, J = residuals(s, T[s.group], jacobian=True)
    h = 1e-6
    for k, e in enumerate(np.eye(6)):
        up, down = (residuals(s, retract(T, sign * h * np.tile(e, (3, 1)))[s.group])[0] for sign in (1, -1))
        np.testing.assert_allclose(J[..., k], (up - down) / (2 * h), atol=1e-6)


def test_poses_are_found_with_honest_information():
    s, T = sightings(np.random.default_rng(1), 200, 3, 1e-4)
    found = resect(s, 200, settings=ResectionSettings())
    assert found.known.all()
    turn = geodesic_angle(matrix_to_quat(found.T[:, :3, :3]), matrix_to_quat(T[:, :3, :3]))
    assert turn.max() < 0.02
    local = transform_inv(found.T) @ T
    error = np.concatenate(
        [np.stack([local[:, 2, 1], local[:, 0, 2], local[:, 1, 0]], axis=1), local[:, :3, 3]], axis=1
    )
    nees = np.einsum("ni,nij,nj->n", error, found.information, error) / 6
    assert np.mean(nees) == pytest.approx(1.0, abs=0.15)


def test_one_small_tag_leaves_two_poses():
    s, T = sightings(np.random.default_rng(2), 300, 1, 5e-4)
    found = resect(s, 300, settings=ResectionSettings())
    angle = geodesic_angle(matrix_to_quat(T[:, :3, :3]), matrix_to_quat(found.T[:, :3, :3]))
    other = geodesic_angle(matrix_to_quat(T[:, :3, :3]), matrix_to_quat(found.other[:, :3, :3]))
    either = np.minimum(angle, np.where(found.ambiguous, other, np.inf))
    assert np.mean(angle > 0.4) > 0.02  # some are flipped, and for those the right one is the alternative
    assert np.quantile(either, 0.97) < 0.3
    assert (found.gain >= 0).all()


def test_a_false_tag_among_five_hardly_matters():
    s, T = sightings(np.random.default_rng(3), 20, 5, 1e-4)
    s.seen[::5] += 0.02  # a tag of each target is elsewhere
    found = resect(replace(s, T_cam_tag=tag_poses(s.seen, s.half)), 20, settings=ResectionSettings())
    assert np.quantile(np.linalg.norm(found.T[:, :3, 3] - T[:, :3, 3], axis=1), 0.9) < 0.004


def test_what_is_not_seen_has_no_pose():
    assert np.isnan(tag_poses(np.full((1, 4, 2), np.nan), np.array([0.1]))).all()


def test_fits_by_parts_are_the_fits_of_all():
    s, _ = sightings(np.random.default_rng(2), 25, 3, 1e-3)
    whole = resect(s, 25, settings=ResectionSettings())
    parts = resect(s, 25, settings=ResectionSettings(fits_at_once=4))
    for item in fields(whole):
        np.testing.assert_allclose(getattr(parts, item.name), getattr(whole, item.name), rtol=1e-6, atol=1e-9)
