"""Kernels of first states are those of dense matrices; how residuals are whitened is in test_whitening."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pytest
from numpy.typing import NDArray

from tossid.diagnosis.likelihood.innovations import costs, gauss_newton

Array = NDArray[np.float64]
W, K, L = 4, 6, 5


class Case(NamedTuple):
    """Windows with correlated errors of each channel, and a difference to another engine."""

    chosen: NDArray[np.int64]
    residuals: Array
    other: Array
    root: Array
    by_state: Array
    deviation: Array
    prior: Array

    def dense(self, b: int) -> tuple[Array, Array, Array]:
        """Derivatives (K (L + 1), 2 K), residuals and the other engine's difference, whitened by all own errors."""
        w = self.chosen[b]
        columns, r, o = [], [], []
        for c in range(K):
            first = np.eye(K, 2 * K)[c]
            S = np.concatenate([first[None], self.by_state[w].reshape(L, K, 2 * K)[:, c]])
            columns.append(self.root[w, c] @ S)
            r.append(self.root[w, c] @ np.append(self.deviation[b, c], self.residuals[b].reshape(L, K)[:, c]))
            o.append(self.root[w, c] @ np.append(0.0, self.other[w].reshape(L, K)[:, c]))
        return np.concatenate(columns), np.concatenate(r), np.concatenate(o)


@pytest.fixture
def case() -> Case:
    rng = np.random.default_rng(0)
    chosen = np.array([3, 0, 2])
    root = np.tril(rng.normal(size=(W, K, L + 1, L + 1))) + 3 * np.eye(L + 1)
    return Case(
        chosen,
        rng.normal(size=(3, K * L)),
        rng.normal(size=(W, K * L)),
        root,
        rng.normal(size=(W, K * L, 2 * K)),
        rng.normal(size=(3, 2 * K)),
        rng.uniform(0.5, 2.0, (W, 2 * K)),
    )


@pytest.mark.parametrize("center", [0.0, 1.0])
def test_costs_have_the_best_multiple_of_the_other_engine(case: Case, center: float) -> None:
    found = np.empty(3)
    costs(case.chosen, case.residuals, center, case.other, case.root, case.deviation, case.prior, found)
    for b in range(3):
        _, r, o = case.dense(b)
        r = r - center * o
        # the multiple is a parameter of standard deviation 1, over which the cost is least
        best = (o @ r) / (1 + o @ o)
        expected = ((r - best * o) ** 2).sum() + best**2
        speeds = case.deviation[b, K:] / case.prior[case.chosen[b], K:]
        assert found[b] == pytest.approx(expected + (speeds**2).sum())


@pytest.mark.parametrize("damping", [0.0, 0.3])
def test_steps_solve_the_normal_equations(case: Case, damping: float) -> None:
    found = np.empty((3, 2 * K))
    gauss_newton(
        case.chosen, case.residuals, 1.0, case.other, case.root, case.by_state, case.deviation, case.prior,
        np.full(3, damping), found,
    )  # fmt: skip
    for b in range(3):
        columns, r, o = case.dense(b)
        J = np.concatenate([columns, o[:, None]], axis=1)
        weight = np.concatenate([np.zeros(K), case.prior[case.chosen[b], K:] ** -2, [1.0]])
        H, g = J.T @ J + np.diag(weight), J.T @ (r - o)
        g[K:-1] += case.deviation[b, K:] * weight[K:-1]
        H += damping * np.diag(np.diag(H))
        np.testing.assert_allclose(found[b], np.linalg.solve(H, g)[:-1], rtol=1e-9, atol=1e-12)
