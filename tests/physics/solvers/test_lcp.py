"""The polyhedral cone by Lemke's algorithm: 10,000 problems, known answers, and a plain reference."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pytest

from tests.physics.solvers.contact_problems import INERTIA, MASS, delassus, draw, draw_many
from tests.physics.solvers.reference import (
    ACCEPTED_KKT_ERROR,
    lcp_kkt_error,
    lcp_matrices,
    lemke_reference,
    tangent_directions,
)
from tossid.physics.solvers import SolverStatus, lcp, solve_contacts
from tossid.physics.solvers.polyhedral_problem import PolyhedralAnswer, PolyhedralProblem
from tossid.physics.solvers.problem import Array


class Solved(NamedTuple):
    """Answers of a batch: impulses, status, KKT error, pivots, shares along the directions, slip speeds."""

    lam: Array
    status: Array
    kkt_error: Array
    pivots: Array
    beta: Array
    gamma: Array


def solve_lcp(A: Array, b: Array, mu: Array, *, n_directions: int = 8, max_pivots: int = 2000) -> Solved:
    """`lcp_kernel` on one problem after another."""
    count, n = len(b), b.shape[1] // 3
    mu = np.broadcast_to(mu, (count, n))
    answers = [PolyhedralAnswer(np.zeros(3 * n), np.zeros((n, n_directions)), np.zeros(n)) for _ in range(count)]
    scratch, directions = lcp.lcp_scratch(n, n_directions), tangent_directions(n_directions)
    ends = [
        lcp.lcp_kernel(
            PolyhedralProblem(A[k], b[k], mu[k], directions),
            answers[k],
            ACCEPTED_KKT_ERROR,
            max_pivots,
            scratch,
        )
        for k in range(count)
    ]
    status, kkt_error, pivots = (np.array(part) for part in zip(*ends, strict=True))
    lam, beta, gamma = (np.array(part) for part in zip(*answers, strict=True))
    return Solved(lam, status, kkt_error, pivots, beta, gamma)


@pytest.mark.parametrize("k", [4, 8])
def test_ten_thousand_problems_satisfy_complementarity_or_say_otherwise(k: int) -> None:
    total, unsolved = 0, 0
    for n, (A, b, mu) in draw_many(10_000, 0).items():
        solution = solve_lcp(A, b, mu, n_directions=k)
        solved = solution.status == SolverStatus.SOLVED
        kkt_error = lcp_kkt_error(A, b, mu, solution.beta, solution.gamma, solution.lam[:, :n])
        assert kkt_error[solved].max() <= ACCEPTED_KKT_ERROR
        tangential = solution.beta @ tangent_directions(k)
        np.testing.assert_allclose(solution.lam[:, n:], tangential.reshape(len(b), 2 * n), rtol=1e-12, atol=1e-12)
        unsolved += np.count_nonzero(~solved)
        total += len(b)
    assert total == 10_000
    assert unsolved / total <= 0.001


def test_agrees_with_the_reference() -> None:
    rng = np.random.default_rng(1)
    for family in ("rest", "slide", "flat", "edge", "point", "vee", "frictionless"):
        for _ in range(5):
            A, b, mu = draw(family, rng)
            n = len(mu)
            M, q = lcp_matrices(A, b, mu, 4)
            z = lemke_reference(M, q)
            fast = solve_lcp(A[None], b[None], mu, n_directions=4)
            assert z is not None
            assert fast.status[0] == SolverStatus.SOLVED
            assert lcp_kkt_error(A, b, mu, z[n : 5 * n].reshape(n, 4), z[5 * n :], z[:n]) <= 1e-8
            if mu[0] <= 0.2:
                w, w_fast = (
                    A @ np.r_[z[:n], (z[n : 5 * n].reshape(n, 4) @ tangent_directions(4)).ravel()],
                    A @ fast.lam[0],
                )
                np.testing.assert_allclose(w_fast[:n], w[:n], atol=1e-7)


def test_without_friction_it_is_the_exact_answer() -> None:
    A, b, mu = draw_many(300, 2, ("frictionless",))[4]
    polyhedral, exact = solve_lcp(A, b, mu), solve_contacts(A, b, mu)
    w = [np.einsum("bij,bj->bi", A, lam) for lam in (polyhedral.lam, exact.lam)]
    np.testing.assert_allclose(w[0], w[1], atol=1e-7)


def test_many_directions_come_close_to_the_exact_cone() -> None:
    """One particle, A = I / m: the cone of k directions misses the friction by at most 1 - cos(pi / k) of it."""
    rng = np.random.default_rng(3)
    b, mu, k = rng.normal(size=(300, 3)), rng.uniform(0, 1, size=(300, 1)), 64
    A = np.tile(np.eye(3) / MASS, (300, 1, 1))
    polyhedral, exact = solve_lcp(A, b, mu, n_directions=k).lam, solve_contacts(A, b, mu).lam
    np.testing.assert_allclose(polyhedral[:, 0], exact[:, 0], atol=1e-10)
    friction = mu[:, 0] * exact[:, 0]
    # Slipping, the impulse is the vertex (or edge) that faces the slip: at most half a sector away.
    gap = np.linalg.norm(polyhedral[:, 1:] - exact[:, 1:], axis=1)
    assert (gap <= 2 * np.sin(np.pi / k / 2) * friction + 1e-10).all()
    assert (
        np.linalg.norm(polyhedral[:, 1:], axis=1) >= np.cos(np.pi / k) * np.linalg.norm(exact[:, 1:], axis=1) - 1e-10
    ).all()


def test_an_impossible_problem_ends_on_a_ray_and_bad_numbers_get_a_status() -> None:
    _, A = delassus(np.zeros((2, 3)), np.array([[1.0, 0, 0], [-1.0, 0, 0]]), MASS, np.full(3, INERTIA))
    b = np.array([[-1.0, -1.0, 0, 0, 0, 0], [np.nan, 0, 0, 0, 0, 0], [-1.0, 1.0, 0.3, 0, 0, 0]])
    solution = solve_lcp(np.stack([A, A, A]), b, np.array([0.3, 0.3]))
    assert solution.status.tolist() == [SolverStatus.INFEASIBLE, SolverStatus.NOT_FINITE, SolverStatus.SOLVED]


def test_too_few_pivots() -> None:
    A, b, mu = draw_many(200, 4, ("flat",))[4]
    short = solve_lcp(A, b, mu, max_pivots=2)
    assert short.pivots.max() == 2
    assert not short.status.any()  # solved by sweeps instead
    assert lcp_kkt_error(A, b, mu, short.beta, short.gamma, short.lam[:, :4]).max() <= ACCEPTED_KKT_ERROR
    _, impossible = delassus(np.zeros((2, 3)), np.array([[1.0, 0, 0], [-1.0, 0, 0]]), MASS, np.full(3, INERTIA))
    never = solve_lcp(impossible[None], np.array([[-1.0, -1.0, 0, 0, 0, 0]]), np.array([0.3, 0.3]), max_pivots=1)
    assert never.status[0] == SolverStatus.MAX_ITERATIONS
    assert never.kkt_error[0] > 0.1


@pytest.mark.parametrize("family", ["rest", "slide", "flat", "duplicate", "edge", "huge friction"])
def test_the_second_try_solves_alone_what_pivoting_might_leave(family: str) -> None:
    """Pivoting in circles of rounding errors is rare; here nothing of its answer is used."""
    rng = np.random.default_rng(5)
    directions = tangent_directions(8)
    for _ in range(20):
        A, b, mu = draw(family, rng)
        n = len(mu)
        lam, beta, gamma = answer = PolyhedralAnswer(np.full(3 * n, 1e3), np.full((n, 8), 1e3), np.zeros(n))
        problem = PolyhedralProblem(A, b, mu, directions)
        kkt_error = lcp.second_try(problem, answer, np.inf, ACCEPTED_KKT_ERROR, 2000, lcp.lcp_scratch(n, 8))
        assert kkt_error <= ACCEPTED_KKT_ERROR
        assert lcp_kkt_error(A, b, mu, beta, gamma, lam[:n]) <= ACCEPTED_KKT_ERROR
        np.testing.assert_allclose(lam[n:], (beta @ directions).ravel(), rtol=1e-12, atol=1e-12)


def test_the_second_try_keeps_the_better_answer() -> None:
    A, b, mu = draw("flat", np.random.default_rng(6))
    n = len(mu)
    best = solve_lcp(A[None], b[None], mu)
    answer = PolyhedralAnswer(best.lam[0].copy(), best.beta[0].copy(), best.gamma[0].copy())
    problem = PolyhedralProblem(A, b, mu, tangent_directions(8))
    kkt_error = lcp.second_try(problem, answer, 0.0, ACCEPTED_KKT_ERROR, 1, lcp.lcp_scratch(n, 8))
    assert kkt_error == 0.0
    np.testing.assert_array_equal(answer.lam, best.lam[0])
