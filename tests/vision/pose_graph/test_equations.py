"""The graph's equations beside their plain forms: projection, factors, least squares and covariances."""

from __future__ import annotations

import gtsam
import numpy as np
import pytest

from tossid.rotations import (
    quat_normalize,
    transform,
    transform_points,
)
from tossid.vision.pose_graph.corner_projection import (
    corner_errors,
    project_tag,
)
from tossid.vision.pose_graph.factors import Noise, View, view_factor
from tossid.vision.pose_graph.least_squares import WEAK_PRIOR, joint_covariance, marginals_of
from tossid.vision.pose_graph.resect import retract
from tossid.vision.setup.hinge import Hinge
from tossid.vision.setup.layout import SQUARE


def test_errors_and_their_derivatives_are_those_of_the_pinhole() -> None:
    rng, h = np.random.default_rng(0), 1e-6
    poses = transform(
        np.array([0, 0, 1.5]) + rng.uniform(-0.1, 0.1, (6, 3)),
        quat_normalize([0.0, 1.0, 0.0, 0.0] + rng.normal(size=(6, 4)) / 4),
    )
    points, seen = 0.04 * SQUARE, 0.1 * rng.normal(size=(4, 2))
    for T in poses:
        x, flat, J = transform_points(T, points), np.empty((4, 2)), np.empty((4, 2, 6))
        project_tag(T, points, flat, J)
        np.testing.assert_allclose(flat, x[:, :2] / x[:, 2:], atol=1e-14)
        np.testing.assert_allclose(corner_errors(T[None], points[None], seen[None])[0], flat - seen, atol=1e-14)
        for k, e in enumerate(np.eye(6)):
            up, down = (transform_points(retract(T[None], sign * h * e[None])[0], points) for sign in (1, -1))
            np.testing.assert_allclose(
                J[..., k], (up[:, :2] / up[:, 2:] - down[:, :2] / down[:, 2:]) / (2 * h), atol=1e-6
            )


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


def test_what_a_graph_leaves_undetermined_has_a_weak_priors_variance() -> None:
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    for key in (0, 1, 2):
        values.insert(key, gtsam.Pose3())
    graph.add(gtsam.PriorFactorPose3(0, gtsam.Pose3(), gtsam.noiseModel.Isotropic.Sigma(6, 0.01)))
    graph.add(gtsam.BetweenFactorPose3(0, 1, gtsam.Pose3(), gtsam.noiseModel.Isotropic.Sigma(6, 0.02)))
    nothing = gtsam.noiseModel.Diagonal.Precisions(np.zeros(6))
    graph.add(gtsam.PriorFactorPose3(2, gtsam.Pose3(), nothing))
    found = marginals_of(graph, values)
    np.testing.assert_allclose(joint_covariance(found, [0, 1]), np.kron([[1, 1], [1, 5]], 1e-4 * np.eye(6)), rtol=1e-3)
    np.testing.assert_allclose(joint_covariance(found, [2]), WEAK_PRIOR**2 * np.eye(6), rtol=1e-9)
