"""The kernels of tracking beside the plain form of what they sum up."""

from __future__ import annotations

import numpy as np

from tests.vision.pose_graph.test_first_poses import sightings
from tossid.rotations import transform_points
from tossid.vision.pose_graph.corner_projection import (
    BEHIND,
    contradictions,
    corner_errors,
    normal_equations,
    project_tag,
    whitened_sizes,
)
from tossid.vision.pose_graph.resect import retract

LIMIT = 1.5


def test_errors_and_their_derivatives_are_those_of_the_pinhole() -> None:
    s, T = sightings(np.random.default_rng(0), 3, 2, 1e-4)
    T = s.T_cam_parent @ T[s.group]
    x = transform_points(T, s.points)
    np.testing.assert_allclose(corner_errors(T, s.points, s.seen), x[..., :2] / x[..., 2:] - s.seen, atol=1e-14)
    flat, J, h = np.empty((4, 2)), np.empty((4, 2, 6)), 1e-6
    for d in range(len(T)):
        project_tag(T[d], s.points[d], flat, J)
        np.testing.assert_allclose(flat, x[d, :, :2] / x[d, :, 2:], atol=1e-14)
        for k, e in enumerate(np.eye(6)):
            up, down = (
                corner_errors(retract(T[d : d + 1], sign * h * e[None]), s.points[d : d + 1], s.seen[d : d + 1])[0]
                for sign in (1, -1)
            )
            np.testing.assert_allclose(J[..., k], (up - down) / (2 * h), atol=1e-6)


def test_sizes_and_normal_equations_are_those_of_the_residuals() -> None:
    rng = np.random.default_rng(4)
    s, T = sightings(rng, 5, 3, 1e-3)
    T = s.T_cam_parent @ retract(T, 0.01 * rng.normal(size=(5, 6)))[s.group]
    whiten = s.whiten + 50 * rng.normal(size=s.whiten.shape)
    r = np.squeeze(whiten @ corner_errors(T, s.points, s.seen)[..., None], -1)
    size = whitened_sizes(T, s.points, s.seen, whiten)
    np.testing.assert_allclose(size, np.linalg.norm(r, axis=-1), rtol=1e-9)
    weight = np.minimum(1, LIMIT / size)
    assert 0.1 < np.mean(weight < 1) < 0.99
    information, gradient = normal_equations(s.group, 5, T, s.points, s.seen, whiten, size, np.full(5, LIMIT))
    flat, J = np.empty((4, 2)), np.empty((len(T), 4, 2, 6))
    for d in range(len(T)):
        project_tag(T[d], s.points[d], flat, J[d])
    J = whiten @ J
    for g in range(5):
        own = s.group == g
        A, b, w = J[own].reshape(-1, 6), r[own].reshape(-1), np.repeat(weight[own].reshape(-1), 2)
        np.testing.assert_allclose(information[g], (A * w[:, None]).T @ A, rtol=1e-9)
        np.testing.assert_allclose(gradient[g], (A * w[:, None]).T @ b, rtol=1e-6)


def test_a_tag_behind_the_lens_weighs_nothing() -> None:
    s, T = sightings(np.random.default_rng(5), 2, 2, 1e-3)
    T[1, 2, 3] -= 100.0
    T, whiten = s.T_cam_parent @ T[s.group], np.ascontiguousarray(s.whiten)
    assert np.isnan(corner_errors(T, s.points, s.seen)[s.group == 1]).all()
    size = whitened_sizes(T, s.points, s.seen, whiten)
    assert (size[s.group == 1] == BEHIND).all()
    information, gradient = normal_equations(s.group, 2, T, s.points, s.seen, whiten, size, np.full(2, LIMIT))
    assert information[0].any()
    assert not information[1].any()
    assert not gradient[1].any()


def test_contradictions_are_geman_and_mcclures_loss() -> None:
    rng = np.random.default_rng(6)
    s, T = sightings(rng, 3, 2, 1e-3)
    candidates = np.concatenate([retract(T, 0.02 * rng.normal(size=(3, 6))), np.full((1, 4, 4), np.nan), T])
    candidates[4, 2, 3] -= 100.0  # behind the lens
    of, by = np.arange(7).repeat(6), np.tile(np.arange(6), 7)
    tolerance = rng.uniform(0.002, 0.01, 6)
    found = contradictions(candidates, of, by, s.T_cam_parent, s.points, s.seen, tolerance)
    square = np.sum(corner_errors(s.T_cam_parent[by] @ candidates[of], s.points[by], s.seen[by]) ** 2, axis=-1)
    square /= tolerance[by, None] ** 2
    loss = np.nan_to_num(square / (1 + square), nan=1.0).sum(axis=1).reshape(7, 6).sum(axis=1)
    assert found[3] == np.inf
    assert found[4] == 24
    usable = [0, 1, 2, 4, 5, 6]
    np.testing.assert_allclose(found[usable], loss[usable], rtol=1e-9)
