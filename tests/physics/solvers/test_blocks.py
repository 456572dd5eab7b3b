"""One contact solved exactly, by its optimality conditions; small factorisations against NumPy's."""

from __future__ import annotations

import numpy as np
import pytest

from tests.physics.solvers.reference import cone_kkt_error, cone_qp_kkt_error
from tossid.kernels import kernel
from tossid.physics.solvers import blocks
from tossid.physics.solvers.workspace import OPEN, SLIP, STICK


@kernel(keep=False)
def programme(A, g, mu):  # type: ignore[no-untyped-def]
    return blocks.block_qp(A, 0, g[0], g[1], g[2], mu, 0.0, 0.0)


@kernel(keep=False)
def exact(A, g, mu):  # type: ignore[no-untyped-def]
    return blocks.block_cone(A, 0, g[0], g[1], g[2], mu, 0.0, 0.0)


@kernel(keep=False)
def by_cholesky(V, m):  # type: ignore[no-untyped-def]
    blocks.cholesky_solve(V, 0, m, m)


@kernel(keep=False)
def by_elimination(V, m):  # type: ignore[no-untyped-def]
    blocks.lu_solve(V, 0, m, m)


@pytest.mark.parametrize(("solve", "kkt_error"), [(programme, cone_qp_kkt_error), (exact, cone_kkt_error)])
def test_one_contact_is_solved_exactly(solve, kkt_error) -> None:  # type: ignore[no-untyped-def]
    rng = np.random.default_rng(0)
    kinds = []
    for _ in range(400):
        root = rng.normal(size=(3, 3))
        A, g, mu = root @ root.T + 0.3 * np.eye(3), rng.normal(size=3), rng.choice([0.0, 0.1, 0.3])
        kind, *x = solve(A, g, mu)
        kinds.append(kind)
        assert kkt_error(A, g, np.array([mu]), np.array(x)) < 1e-9 * (1 + np.abs(g).max())
        w = A @ x + g
        if kind == STICK:
            np.testing.assert_allclose(w, 0, atol=1e-10)
        if kind == SLIP:
            assert np.hypot(x[1], x[2]) == pytest.approx(mu * x[0], abs=1e-12)
        if kind == OPEN:
            assert x == [0.0, 0.0, 0.0]
    assert set(kinds) == {OPEN, STICK, SLIP}


@pytest.mark.parametrize("solve", [by_cholesky, by_elimination])
def test_systems_are_solved(solve) -> None:  # type: ignore[no-untyped-def]
    rng = np.random.default_rng(1)
    for m in (1, 2, 5, 12):
        root = rng.normal(size=(m, m))
        H, y = root @ root.T + np.eye(m), rng.normal(size=m)
        if solve is by_elimination:
            H = np.roll(H, 1, axis=0) + rng.normal(size=(m, m))  # not symmetric, and no good pivots on its diagonal
        V = np.vstack([H, y])
        solve(V, m)
        np.testing.assert_allclose(V[m], np.linalg.solve(H, y), rtol=1e-8, atol=1e-10)


@pytest.mark.parametrize("solve", [by_cholesky, by_elimination])
def test_a_singular_consistent_system_gets_a_solution(solve) -> None:  # type: ignore[no-untyped-def]
    """Four corners on a plane: rank 6 of 12."""
    rng = np.random.default_rng(2)
    J = rng.normal(size=(12, 6))
    H, y = J @ J.T, J @ rng.normal(size=6)
    V = np.vstack([H, y])
    solve(V, 12)
    np.testing.assert_allclose(H @ V[12], y, atol=1e-4)
