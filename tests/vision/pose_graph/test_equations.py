"""The graph's equations beside their plain forms: first poses, kernels, factors, least squares and covariances."""

from __future__ import annotations

import gtsam
import numpy as np
import pytest

from tossid.rotations import (
    quat_normalize,
    transform,
    transform_inv,
    transform_points,
)
from tossid.vision.pose_graph.corner_projection import (
    contradictions,
    corner_errors,
    normal_equations,
    project_tag,
    whitened_sizes,
)
from tossid.vision.pose_graph.factors import Noise, View, measurement_factor, view_factor
from tossid.vision.pose_graph.least_squares import SingularError, covariances
from tossid.vision.pose_graph.resect import Sightings, retract, tag_poses
from tossid.vision.setup.hinge import Hinge
from tossid.vision.setup.layout import SQUARE, Measurement


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


def _pose(rng: np.random.Generator, p: list[float]) -> gtsam.Pose3:
    return gtsam.Pose3(
        transform(np.array(p) + 0.05 * rng.normal(size=3), quat_normalize([1.0, 0, 0, 0] + 0.2 * rng.normal(size=4)))
    )


def _size(key: int) -> int:
    return {"o": 1, "j": 1, "p": 3}.get(chr(gtsam.Symbol(key).chr()), 6)


def _jacobians(factor: gtsam.NoiseModelFactor, values: gtsam.Values) -> tuple[np.ndarray, np.ndarray]:
    """A factor's own derivative by all its variables, and that by differences."""
    A, _ = gtsam.JacobianFactor(factor.linearize(values)).jacobian()
    columns = []
    for key in factor.keys():  # noqa: SIM118
        for e in np.eye(_size(key)):
            ends = []
            for sign in (1, -1):
                delta = gtsam.VectorValues()
                for other in values.keys():  # noqa: SIM118
                    delta.insert(other, sign * 1e-6 * e if other == key else np.zeros(_size(other)))
                ends.append(factor.whitenedError(values.retract(delta)))
            columns.append((ends[0] - ends[1]) / 2e-6)
    return A, np.stack(columns, axis=1)


@pytest.mark.parametrize(("outlier", "spread_sigma"), [(False, 0.0), (True, 0.0), (False, 2.0)])
def test_a_views_derivatives(outlier: bool, spread_sigma: float):
    """By camera, rig, body, two tags, a print and the clock, while body and rig move, within and beyond Huber's
    threshold, and where edges spread."""
    rng = np.random.default_rng(0)
    values = gtsam.Values()
    for key, p in enumerate(([0.0, 0, 0], [0.0, 0, 0], [0.0, 0, 1.2], [0.05, 0, 0], [-0.05, 0, 0])):
        values.insert(key, _pose(rng, p))
    clock, print_ = int(gtsam.symbol("o", 0)), int(gtsam.symbol("p", 4))
    values.insert(clock, 0.001)
    values.insert(print_, np.array([0.02, -0.01, 0.03]))
    twists, W = (rng.normal(size=6), 5 * rng.normal(size=6)), np.tile(300.0 * np.eye(2), (2, 4, 1, 1))
    half, one = np.array([0.04, 0.03]), np.ones(2)
    blank = View(0, 1, 2, (3, 4), half, np.zeros((2, 4, 2)), W / 1e6, one, 0.004, *twists, clock)
    seen = 1e6 / 300 * view_factor(blank, {}, Noise()).unwhitenedError(values).reshape(2, 4, 2)
    seen += rng.normal(size=(2, 4, 2)) * (0.05 if outlier else 0.001)
    growth, prints = rng.normal(size=(2, 4, 2)) / 300, {4: (np.zeros(3), print_)}
    view = View(0, 1, 2, (3, 4), half, seen, W, one, 0.004, *twists, clock, edge_growth=growth, prints=prints)
    factor = view_factor(view, {}, Noise(spread_sigma=spread_sigma))
    A, numerical = _jacobians(factor, values)
    # Huber's own derivative is the gradient's: compare Jᵀr, which is exact, and J itself where it is linear
    r = factor.unwhitenedError(values)
    np.testing.assert_allclose(A.T @ r, numerical.T @ r, rtol=2e-3, atol=1e-2)
    if not outlier:
        np.testing.assert_allclose(A, numerical, rtol=1e-3, atol=2e-2)


def test_the_derivatives_of_a_view_of_a_body_that_hangs_on_others() -> None:
    rng, values = np.random.default_rng(2), gtsam.Values()
    joints = []
    for k in range(2):
        axis = rng.normal(size=3)
        T = transform(0.1 * rng.normal(size=3), quat_normalize(rng.normal(size=4)))
        joints.append(
            (int(gtsam.symbol("j", k)), Hinge("a", T, axis / np.linalg.norm(axis), 0.05 * rng.normal(size=3)))
        )
        values.insert(joints[k][0], float(rng.uniform(-1, 1)))
    values.insert(2, gtsam.Pose3(transform(np.array([0.0, 0, 1.2]), quat_normalize(rng.normal(size=4)))))
    fixed = {0: np.eye(4), 1: np.eye(4), 3: transform(np.array([0.02, 0, 0]), np.array([1.0, 0, 0, 0]))}
    W, still, far = np.tile(np.eye(2), (1, 4, 1, 1)), np.zeros(6), 1e9 * np.ones(1)
    view = View(
        0, 1, 2, (3,), np.array([0.03]), np.zeros((1, 4, 2)), W, far, 0.0, still, still, None, tuple(joints)
    )  # fmt: skip
    np.testing.assert_allclose(*_jacobians(view_factor(view, fixed, Noise()), values), atol=1e-6)


@pytest.mark.parametrize(
    ("measurement", "keys"),
    [
        (Measurement("distance", ((1, 0), (2, 3)), 0.5, 0.01), [(0, 1), (2, 3)]),
        (Measurement("coordinate", ((1, 2),), 0.5, 0.01, np.array([0, 0.6, 0.8])), [(0, 1)]),
    ],
)
def test_a_measurements_derivatives(measurement: Measurement, keys: list[tuple[int, int]]):
    rng, values = np.random.default_rng(1), gtsam.Values()
    for key in range(4):
        values.insert(key, _pose(rng, [key * 0.3, 0.1, 0.0]))
    factor = measurement_factor(measurement, keys, [0.05, 0.04][: len(keys)], {})
    np.testing.assert_allclose(*_jacobians(factor, values), rtol=1e-4, atol=1e-3)


SHARED, STEPS = {1: 3, 2: 2}, {10: 3, 11: 3, 12: 3, 20: 1}


def _factor(keys: list[int], rng: np.random.Generator, rows: int = 4) -> gtsam.JacobianFactor:
    terms = [part for key in keys for part in (key, rng.normal(size=(rows, (SHARED | STEPS)[key])))]
    return gtsam.JacobianFactor(*terms, rng.normal(size=rows), gtsam.noiseModel.Isotropic.Sigma(rows, 0.3))


def _graph(seed: int = 0) -> gtsam.GaussianFactorGraph:
    """Three steps that meet in what is shared; one of them has a joint."""
    rng, graph = np.random.default_rng(seed), gtsam.GaussianFactorGraph()
    for keys in ([1], [1, 10], [10, 2], [2, 11, 1], [12, 20, 1], [20, 2], [12], [1, 2]):
        graph.add(_factor(keys, rng))
    return graph


def test_blocks_are_those_of_the_inverse_hessian() -> None:
    graph = _graph()
    found = covariances(graph, SHARED | STEPS, SHARED, damping=0.2)
    assert found is not None
    keys = graph.keyVector()
    whole = np.linalg.inv(graph.hessian()[0] + 0.2 * np.eye(15))
    first = dict(zip(keys, np.cumsum([0, *((SHARED | STEPS)[key] for key in keys)]), strict=False))
    for group in ([1], [2], [1, 2], [10], [11], [12], [20], [12, 20], [20, 12]):
        at = np.concatenate([np.arange(first[key], first[key] + (SHARED | STEPS)[key]) for key in group])
        np.testing.assert_allclose(found.joint(group), whole[np.ix_(at, at)], rtol=1e-8, atol=1e-12)


def test_what_nothing_determines_is_named() -> None:
    rng, graph = np.random.default_rng(1), gtsam.GaussianFactorGraph()
    for keys in ([1, 10], [10, 2], [2, 10]):
        graph.add(_factor(keys, rng))
    graph.add(gtsam.JacobianFactor(11, np.zeros((1, 3)), np.zeros(1), gtsam.noiseModel.Unit.Create(1)))
    with pytest.raises(SingularError, match=r"Symbol: 11\)"):
        covariances(graph, SHARED | {10: 3, 11: 3}, SHARED)
