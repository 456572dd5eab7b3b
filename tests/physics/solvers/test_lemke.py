"""Lemke's algorithm on linear complementarity problems: against a plain one, and where there is no solution."""

from __future__ import annotations

import numpy as np

from tests.physics.solvers.reference import lemke_reference
from tossid.physics.solvers.lemke import basic_solution, lemke
from tossid.physics.solvers.workspace import INFEASIBLE, MAX_ITERATIONS, SOLVED


def solved(M: np.ndarray, q: np.ndarray, limit: int = 500) -> tuple[int, np.ndarray, np.ndarray]:
    """(status, z, z again from the final basis)."""
    size = len(q)
    T, basis, ties = np.empty((size + 1, 2 * size + 2)), np.empty(size, np.int64), np.empty(size, np.int64)
    status, _ = lemke(M, q, size, limit, T, basis, ties)
    z = np.zeros((2, 2 * size + 1))
    z[0, basis] = T[:size, -1]
    if status == SOLVED:
        basic_solution(M, q, size, basis, T, size)
        z[1, basis] = T[size, :size]
    return status, z[0, size : 2 * size], z[1, size : 2 * size]


def test_positive_definite_problems_are_solved() -> None:
    """Their solution is unique."""
    rng = np.random.default_rng(0)
    for size in (1, 2, 5, 12):
        for _ in range(20):
            root = rng.normal(size=(size, size))
            M, q = root @ root.T + 0.1 * np.eye(size) + (root - root.T), rng.normal(size=size)
            status, z, again = solved(M, q)
            assert status == SOLVED
            w = M @ z + q
            assert min(z.min(), w.min()) > -1e-9
            assert abs(z @ w) < 1e-8
            np.testing.assert_allclose(again, z, atol=1e-9)
            np.testing.assert_allclose(z, lemke_reference(M, q), atol=1e-8)


def test_nothing_to_do_needs_no_pivot() -> None:
    status, z, _ = solved(np.eye(3), np.array([1.0, 0.0, 2.0]))
    assert status == SOLVED
    assert not z.any()


def test_a_problem_without_a_solution_ends_on_a_ray() -> None:
    """w = -z - 1 is negative for every z >= 0."""
    assert solved(-np.eye(2), np.array([-1.0, -2.0]))[0] == INFEASIBLE


def test_the_limit_on_pivots_is_kept() -> None:
    rng = np.random.default_rng(1)
    root = rng.normal(size=(8, 8))
    assert solved(root @ root.T, -np.ones(8), limit=1)[0] == MAX_ITERATIONS
