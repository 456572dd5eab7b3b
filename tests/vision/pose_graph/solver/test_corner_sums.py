"""The kernels of resection beside the plain form of what they sum up."""

from __future__ import annotations

import numpy as np

from tests.vision.pose_graph.test_resect import sightings
from tossid.rotations import transform_points
from tossid.vision.pose_graph.resect import residuals, retract
from tossid.vision.pose_graph.solver.corner_sums import BEHIND, contradictions, normal_equations, residual_sizes

HUBER = 1.5


def test_sizes_and_normal_equations_are_those_of_the_residuals() -> None:
    rng = np.random.default_rng(4)
    s, T = sightings(rng, 5, 3, 1e-3)
    T = retract(T, 0.01 * rng.normal(size=(5, 6)))
    whiten = s.whiten + 50 * rng.normal(size=s.whiten.shape)
    r, J = residuals(s, T[s.group], jacobian=True)
    r, J = np.squeeze(whiten @ r[..., None], -1), whiten @ J
    size = residual_sizes(s.group, s.T_cam_parent, T, s.points, s.seen, whiten)
    np.testing.assert_allclose(size, np.linalg.norm(r, axis=-1), rtol=1e-9)
    weight = np.minimum(1, HUBER / size)
    assert 0.1 < np.mean(weight < 1) < 0.99
    information, gradient = normal_equations(
        s.group, s.T_cam_parent, T, s.points, s.seen, whiten, size, np.full(5, HUBER)
    )
    for g in range(5):
        own = s.group == g
        A, b, w = J[own].reshape(-1, 6), r[own].reshape(-1), np.repeat(weight[own].reshape(-1), 2)
        np.testing.assert_allclose(information[g], (A * w[:, None]).T @ A, rtol=1e-9)
        np.testing.assert_allclose(gradient[g], (A * w[:, None]).T @ b, rtol=1e-6)


def test_a_tag_behind_the_lens_weighs_nothing() -> None:
    s, T = sightings(np.random.default_rng(5), 2, 2, 1e-3)
    T[1, 2, 3] -= 100.0
    size = residual_sizes(s.group, s.T_cam_parent, T, s.points, s.seen, np.ascontiguousarray(s.whiten))
    assert (size[s.group == 1] == BEHIND).all()
    limit = np.full(2, HUBER)
    whiten = np.ascontiguousarray(s.whiten)
    information, gradient = normal_equations(s.group, s.T_cam_parent, T, s.points, s.seen, whiten, size, limit)
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
    x = transform_points(s.T_cam_parent[by] @ candidates[of], s.points[by])
    square = np.sum((x[..., :2] / x[..., 2:] - s.seen[by]) ** 2, axis=-1) / tolerance[by, None] ** 2
    loss = np.where(x[..., 2] > 0, square / (1 + square), 1.0).sum(axis=1).reshape(7, 6).sum(axis=1)
    assert found[3] == np.inf
    assert found[4] == 24
    usable = [0, 1, 2, 4, 5, 6]
    np.testing.assert_allclose(found[usable], loss[usable], rtol=1e-9)
