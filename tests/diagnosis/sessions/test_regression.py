"""Robust regressions have the truth in their intervals, and cost less where they are the truth."""

from __future__ import annotations

import numpy as np
import pytest

from tossid.diagnosis.sessions.regression import robust_regression

N = 40
LINE = np.arange(N)[:, None] - 0.5 * (N - 1)


def drawn(rng: np.random.Generator, *, scatter: float, odd: float = 5.0) -> tuple[np.ndarray, np.ndarray]:
    """Two parameters that drift, with errors of different sizes, scatter, and two odd tosses."""
    sigma = rng.uniform(0.05, 0.5, size=(N, 2))
    values = np.array([1.0, -2.0]) + LINE * [0.05, -0.02] + np.hypot(sigma, scatter) * rng.normal(size=(N, 2))
    values[[3, N - 4]] += odd
    return values, np.array([np.diag(row**-2) for row in sigma])


@pytest.mark.parametrize("scatter", [0.0, 0.3])
def test_the_true_slope_is_in_its_interval(scatter: float) -> None:
    rng, inside, scatters = np.random.default_rng(1), [], []
    for _ in range(100):
        found = robust_regression(*drawn(rng, scatter=scatter), LINE, outlier=3.0)
        off = found.coefficients[1] - [0.05, -0.02]
        inside.append(np.abs(off) < 2.02 * np.sqrt(np.diagonal(found.covariance[1, :, 1])))
        scatters.append(found.scatter)
    assert np.mean(inside) == pytest.approx(0.95, abs=0.06)
    assert np.median(scatters) == pytest.approx(scatter, abs=0.06)


def test_what_says_nothing_does_not_count() -> None:
    values, info = drawn(np.random.default_rng(2), scatter=0.1)
    plain = robust_regression(values[5:], info[5:], LINE[5:], outlier=3.0)
    values[:5], info[:5] = np.nan, 0.0
    found = robust_regression(values, info, LINE, outlier=3.0)
    assert found.n == N - 5
    np.testing.assert_allclose(found.coefficients, plain.coefficients)
    np.testing.assert_allclose(found.covariance, plain.covariance)


def test_the_true_design_costs_less() -> None:
    rng, step = np.random.default_rng(3), (LINE > 0).astype(float)
    designs = (LINE, step, np.column_stack([LINE, step]), LINE[:, :0])
    cheapest = []
    for _ in range(30):
        values, info = drawn(rng, scatter=0.1, odd=0.0)
        costs = [robust_regression(values, info, each, outlier=3.0, scatter=0.1).cost for each in designs]
        cheapest.append(int(np.argmin(costs)))
    # (one parameter more is preferred by chance in about one of forty)
    assert np.mean(np.array(cheapest) == 0) > 0.85
