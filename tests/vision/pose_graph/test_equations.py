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
from tossid.vision.pose_graph.least_squares import SingularError, covariances
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
