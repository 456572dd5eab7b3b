"""The graph's factors: their derivatives, and the robust loss in them."""

from __future__ import annotations

import gtsam
import numpy as np
import pytest

from tossid.rotations import quat_normalize, transform
from tossid.vision.pose_graph.factors import Noise, View, measurement_factor, view_factor
from tossid.vision.setup.hinge import Hinge
from tossid.vision.setup.layout import Measurement


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


def test_a_views_error_is_hubers_loss():
    values = gtsam.Values()
    values.insert(2, gtsam.Pose3(transform(np.array([0.0, 0, 1.0]), np.array([1.0, 0, 0, 0]))))
    fixed = {0: np.eye(4), 1: np.eye(4), 3: np.eye(4)}
    seen = 0.05 * np.array([[[-1.0, -1], [1, -1], [1, 1], [-1, 1]]]) + [0.1, 0.0]
    W, still = np.tile(100.0 * np.eye(2), (1, 4, 1, 1)), np.zeros(6)
    view = View(0, 1, 2, (3,), np.array([0.05]), seen, W, np.ones(1), 0.0, still, still)
    r = 10.0  # 0.1 off, in units of 0.01
    assert view_factor(view, fixed, Noise()).error(values) == pytest.approx(4 * (3 * r - 4.5))
    # a corner beyond the lens model's reach is far off, and no error
    values.update(2, gtsam.Pose3(transform(np.array([0.0, 0, -1.0]), np.array([1.0, 0, 0, 0]))))
    assert np.isfinite(view_factor(view, fixed, Noise()).error(values))
