"""Resistance to spin at one contact: an angular impulse that stops a spin and never turns it.

What it does to a body on the ground is in `effects/test_world.py`.
"""

from __future__ import annotations

import numpy as np

from tossid.kernels import kernel
from tossid.physics.contact import holding


@kernel(keep=False)
def resisted(impulse, L, row, y, xi):  # type: ignore[no-untyped-def]
    holding.resist(impulse, L, row, y, xi)


@kernel(keep=False)
def solved(L, y, n):  # type: ignore[no-untyped-def]
    holding.solve_rates(L, y, n)


def factor(S: np.ndarray) -> np.ndarray:
    """Cholesky factor with the inverse of its diagonal on the diagonal."""
    L = np.linalg.cholesky(S)
    np.fill_diagonal(L, 1 / np.diag(L))
    return L


def test_rates_are_those_of_an_impulse() -> None:
    rng = np.random.default_rng(0)
    for n in (3, 5):
        root = rng.normal(size=(n, n))
        S, y = root @ root.T + np.eye(n), rng.normal(size=n)
        expected = np.linalg.solve(S, y)
        solved(factor(S), y, n)
        np.testing.assert_allclose(y, expected, rtol=1e-10)


def test_a_spin_is_slowed_or_stopped_and_loses_energy() -> None:
    rng = np.random.default_rng(1)
    stopped = 0
    for _ in range(100):
        root = rng.normal(size=(4, 4))
        S, row, xi, impulse = root @ root.T + np.eye(4), rng.normal(size=4), rng.normal(size=4), rng.uniform(0, 2)
        before, after = xi.copy(), xi.copy()
        resisted(impulse, factor(S), row, np.zeros(4), after)
        taken = S @ (before - after)
        share = taken @ row / (row @ row)
        np.testing.assert_allclose(taken, share * row, atol=1e-10)  # about the row's axis alone
        assert abs(share) <= impulse + 1e-12
        assert (row @ after) * (row @ before) >= -1e-12
        assert after @ S @ after <= before @ S @ before + 1e-12
        if abs(row @ after) < 1e-12:
            stopped += 1
        else:
            assert abs(share) > impulse - 1e-12
    assert 20 < stopped < 100
