"""The interior-point method: the scaling's definition, and answers near the minimum."""

from __future__ import annotations

import numpy as np
import pytest

from tests.physics.solvers.contact_problems import draw, draw_many
from tossid.physics.solvers import solve_cone_qp
from tossid.physics.solvers.interior import (
    add_inverse_square,
    apply_scaling,
    interior_point,
    interior_start,
    longest_step,
    nt_scaling,
)
from tossid.physics.solvers.problem import contact_rows

START = np.array([0, 3, 4, 7])  # a cone, a half line, a cone


def inside(rng: np.random.Generator) -> np.ndarray:
    """A point inside the three cones."""
    x = rng.normal(size=7)
    x[0], x[3], x[4] = np.hypot(x[1], x[2]) * 1.2 + 0.1, abs(x[3]) + 0.1, np.hypot(x[5], x[6]) * 1.5 + 0.1
    return x


def test_the_scaling_sends_both_points_to_the_same_one() -> None:
    """Nesterov and Todd's W is symmetric, with W z = W^-1 x."""
    rng = np.random.default_rng(0)
    for _ in range(30):
        x, z = inside(rng), inside(rng)
        wbar, beta = np.zeros(7), np.zeros(3)
        nt_scaling(x, z, START, 3, wbar, beta)
        W, inverse = np.zeros((7, 7)), np.zeros((7, 7))
        for j in range(7):
            column = np.zeros(7)
            apply_scaling(wbar, beta, START, 3, np.eye(7)[j], column, False)
            W[:, j] = column
            apply_scaling(wbar, beta, START, 3, np.eye(7)[j], column, True)
            inverse[:, j] = column
        np.testing.assert_allclose(W, W.T, atol=1e-12)
        np.testing.assert_allclose(W @ inverse, np.eye(7), atol=1e-10)
        np.testing.assert_allclose(W @ z, inverse @ x, rtol=1e-8)
        H = np.zeros((7, 7))
        add_inverse_square(wbar, beta, START, 3, H)
        np.testing.assert_allclose(H, inverse @ inverse, atol=1e-9 * np.abs(H).max())


def test_the_longest_step_ends_on_a_cone_s_surface() -> None:
    rng = np.random.default_rng(1)
    for _ in range(50):
        x, d = inside(rng), 5 * rng.normal(size=7)
        part = longest_step(x, d, START, 3)
        y = x + part * d
        to_surface = [y[0] - np.hypot(y[1], y[2]), y[3], y[4] - np.hypot(y[5], y[6])]
        assert min(to_surface) >= -1e-9 * (1 + part)
        assert part == 1e3 or min(to_surface) <= 1e-9 * (1 + part)


def test_interior_point_comes_close_to_every_minimum() -> None:
    for n, (A, c, mu) in draw_many(240, 7, ("flat", "edge", "point", "vee", "random")).items():
        rows = np.ravel([contact_rows(i, n) for i in range(n)])
        lam = solve_cone_qp(A, c, mu).lam
        for k in range(len(c)):
            answer = np.zeros(3 * n)
            interior_point(np.ascontiguousarray(A[k][np.ix_(rows, rows)]), c[k][rows], mu[k], n, answer)
            other = np.zeros(3 * n)
            other[rows] = answer
            values = [0.5 * x @ A[k] @ x + c[k] @ x for x in (lam[k], other)]
            assert values[1] == pytest.approx(values[0], abs=1e-5 * (1 + abs(values[0])))


def test_the_interior_point_s_start_is_near_the_minimum() -> None:
    A, c, mu = draw("flat", np.random.default_rng(0), mu=0.3)
    A = A + 1e-3 * np.eye(12)  # so that the impulses are unique
    best = solve_cone_qp(A[None], c[None], mu).lam[0]
    np.testing.assert_allclose(interior_start(A, c, mu), best, atol=1e-5 * (1 + np.abs(best).max()))
