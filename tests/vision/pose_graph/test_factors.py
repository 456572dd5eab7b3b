"""The graph's factors: their derivatives, and the robust loss in them."""

from __future__ import annotations

import gtsam
import numpy as np
import pytest

from tossid.rotations import quat_normalize, transform
from tossid.vision.pose_graph.factors import Noise, View, measurement_factor, view_factor
from tossid.vision.setup.layout import Coordinate, Distance


def _pose(rng: np.random.Generator, p: list[float]) -> gtsam.Pose3:
    return gtsam.Pose3(
        transform(np.array(p) + 0.05 * rng.normal(size=3), quat_normalize([1.0, 0, 0, 0] + 0.2 * rng.normal(size=4)))
    )


def _numerical(factor: gtsam.NoiseModelFactor, values: gtsam.Values, key: int, n: int) -> np.ndarray:
    columns = []
    for e in np.eye(n):
        shifted = []
        for sign in (1, -1):
            delta = gtsam.VectorValues()
            for other in values.keys():  # noqa: SIM118
                size = {"o": 1, "p": 3}.get(chr(gtsam.Symbol(other).chr()), 6)
                delta.insert(other, sign * 1e-6 * e if other == key else np.zeros(size))
            shifted.append(factor.unwhitenedError(values.retract(delta)))
        columns.append((shifted[0] - shifted[1]) / 2e-6)
    return np.stack(columns, axis=1)


@pytest.mark.parametrize(("outlier", "spread_sigma"), [(False, 0.0), (True, 0.0), (False, 2.0)])
def test_a_views_derivatives(outlier: bool, spread_sigma: float):
    """By camera, rig, body, two tags, a print and the clock, while body and rig move, within and beyond Huber's
    threshold, and where edges spread."""
    rng = np.random.default_rng(0)
    values = gtsam.Values()
    for key, p in enumerate(([0.0, 0, 0], [0.0, 0, 0], [0.0, 0, 1.2], [0.05, 0, 0], [-0.05, 0, 0])):
        values.insert(key, _pose(rng, p))
    clock = int(gtsam.symbol("o", 0))
    values.insert(clock, 0.001)
    print_ = int(gtsam.symbol("p", 4))
    values.insert(print_, np.array([0.02, -0.01, 0.03]))
    twists, W = (rng.normal(size=6), 5 * rng.normal(size=6)), np.tile(300.0 * np.eye(2), (2, 4, 1, 1))
    half = np.array([0.04, 0.03])
    blank = View(
        0, 1, 2, (3, 4), np.array([0.04, 0.03]), np.zeros((2, 4, 2)), W / 1e6, np.ones(2), 0.004, *twists, clock
    )
    seen = 1e6 / 300 * view_factor(blank, {}, Noise()).unwhitenedError(values).reshape(2, 4, 2)
    seen += rng.normal(size=(2, 4, 2)) * (0.05 if outlier else 0.001)
    view = View(
        0, 1, 2, (3, 4), half, seen, W, np.ones(2), 0.004, *twists, clock,
        edge_growth=rng.normal(size=(2, 4, 2)) / 300, prints={4: (np.zeros(3), print_)},
    )  # fmt: skip
    factor = view_factor(view, {}, Noise(spread_sigma=spread_sigma))
    linear = factor.linearize(values)
    jacobian = gtsam.JacobianFactor(linear)
    A, _ = jacobian.jacobian()
    at = 0
    for key in list(factor.keys()):
        n = {clock: 1, print_: 3}.get(key, 6)
        # Huber's own derivative is the gradient's: compare Jᵀr, which is exact, and J itself where it is linear
        numerical = _numerical(factor, values, key, n)
        r = factor.unwhitenedError(values)
        np.testing.assert_allclose(A[:, at : at + n].T @ r, numerical.T @ r, rtol=2e-3, atol=1e-2)
        if not outlier:
            np.testing.assert_allclose(A[:, at : at + n], numerical, rtol=1e-3, atol=2e-2)
        at += n


def test_a_views_error_is_hubers_loss():
    values = gtsam.Values()
    values.insert(2, gtsam.Pose3(transform(np.array([0.0, 0, 1.0]), np.array([1.0, 0, 0, 0]))))
    fixed = {0: np.eye(4), 1: np.eye(4), 3: np.eye(4)}
    corners = 0.05 * np.array([[-1.0, -1], [1, -1], [1, 1], [-1, 1]])
    seen = corners[None] + [0.1, 0.0]
    view = View(0, 1, 2, (3,), np.array([0.05]), seen, np.tile(100.0 * np.eye(2), (1, 4, 1, 1)), np.ones(1), 0.0, np.zeros(6), np.zeros(6))  # fmt: skip  # noqa: E501
    r = 10.0  # 0.1 off, in units of 0.01
    assert view_factor(view, fixed, Noise()).error(values) == pytest.approx(4 * (3 * r - 4.5))
    # a corner beyond the lens model's reach is far off, and no error
    values.update(2, gtsam.Pose3(transform(np.array([0.0, 0, -1.0]), np.array([1.0, 0, 0, 0]))))
    assert np.isfinite(view_factor(view, fixed, Noise()).error(values))


@pytest.mark.parametrize("kind", ["distance", "coordinate"])
def test_a_measurements_derivatives(kind: str):
    rng = np.random.default_rng(1)
    values = gtsam.Values()
    for key in range(4):
        values.insert(key, _pose(rng, [key * 0.3, 0.1, 0.0]))
    if kind == "distance":
        factor = measurement_factor(Distance("d", (1, 2), (0, 3), 0.5, 0.01), [(0, 1), (2, 3)], [0.05, 0.04], {})
    else:
        factor = measurement_factor(Coordinate("z", 1, 2, np.array([0, 0.6, 0.8]), 0.5, 0.01), [(0, 1)], [0.05], {})
    A, _ = gtsam.JacobianFactor(factor.linearize(values)).jacobian()
    for k, key in enumerate(factor.keys()):
        numerical = _numerical(factor, values, key, 6)
        np.testing.assert_allclose(A[:, 6 * k : 6 * k + 6], numerical / 0.01, rtol=1e-4, atol=1e-3)
