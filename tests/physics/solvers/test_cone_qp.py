"""The cone programme: against a plain reference, its optimality conditions, and known answers."""

from __future__ import annotations

import numpy as np
import pytest

from tests.physics.solvers.contact_problems import draw, draw_many
from tests.physics.solvers.reference import cone_qp_kkt_error, cone_qp_reference, project_cones
from tossid.errors import InputError
from tossid.physics.solvers import SolverStatus, solve_cone_qp


def test_thousands_of_problems_are_solved_exactly() -> None:
    total, unsolved = 0, 0
    for A, c, mu in draw_many(10_000, 0).values():
        solution = solve_cone_qp(A, c, mu)
        kkt_error = cone_qp_kkt_error(A, c, mu, solution.lam)
        rounding = 1e-12 + 1e-13 * np.einsum("bij,bj->bi", np.abs(A), np.abs(solution.lam)).max(axis=1)
        assert (np.abs(kkt_error - solution.kkt_error) <= rounding).all()
        assert (kkt_error <= 1e-9 + rounding)[solution.status == SolverStatus.SOLVED].all()
        unsolved += solution.unsolved
        total += len(c)
    assert unsolved / total <= 0.002


@pytest.mark.parametrize("family", ["rest", "slide", "edge", "point", "duplicate", "vee", "random"])
def test_agrees_with_the_reference(family: str) -> None:
    rng = np.random.default_rng(2)
    for _ in range(6):
        A, c, mu = draw(family, rng)
        lam, kkt_error = cone_qp_reference(A, c, mu, tolerance=1e-8, max_iterations=20_000)
        fast = solve_cone_qp(A[None], c[None], mu)
        assert fast.unsolved == 0
        # The minimum and A lam are unique, lam need not be.
        best, found = (0.5 * x @ A @ x + c @ x for x in (lam, fast.lam[0]))
        assert found <= best + 1e-13
        if kkt_error <= 1e-8:
            np.testing.assert_allclose(A @ fast.lam[0], A @ lam, atol=2e-4 * (1 + np.abs(c).max()))
            assert found == pytest.approx(best, abs=1e-8)


def test_no_feasible_impulse_is_lower() -> None:
    rng = np.random.default_rng(3)
    for A, c, mu in draw_many(240, 3).values():
        lam = solve_cone_qp(A, c, mu).lam
        for k in range(len(c)):
            value = 0.5 * lam[k] @ A[k] @ lam[k] + c[k] @ lam[k]
            size = 1e-3 * (1 + np.abs(lam[k]).max())
            for _ in range(5):
                other = project_cones(lam[k] + size * rng.normal(size=len(c[k])), mu[k])
                assert 0.5 * other @ A[k] @ other + c[k] @ other >= value - 1e-9


def test_one_contact_has_the_closed_form() -> None:
    """With A = a I the answer is the Euclidean projection of -c / a on the cone."""
    rng = np.random.default_rng(4)
    c, mu = rng.normal(size=(500, 3)), rng.uniform(0, 2, size=(500, 1))
    lam = solve_cone_qp(np.tile(2.5 * np.eye(3), (500, 1, 1)), c, mu).lam
    expected = np.array([project_cones(-c[k] / 2.5, mu[k]) for k in range(500)])
    np.testing.assert_allclose(lam, expected, atol=1e-12)


def test_a_warm_start_at_the_answer_needs_no_iteration_and_threads_change_nothing() -> None:
    A, c, mu = draw_many(600, 6, ("slide", "flat"))[4]
    cold = solve_cone_qp(A, c, mu)
    warm = solve_cone_qp(A, c, mu, warm=cold.lam)
    assert cold.unsolved == 0
    np.testing.assert_array_equal(warm.lam, cold.lam)
    np.testing.assert_array_equal(solve_cone_qp(A, c, mu, n_threads=2).lam, cold.lam)


def test_bad_numbers_get_a_status_and_bad_shapes_an_error() -> None:
    A, c = np.tile(np.eye(3), (2, 1, 1)), np.array([[-1.0, 0, 0], [np.nan, 0, 0]])
    solution = solve_cone_qp(A, c, np.array([0.5]))
    assert solution.status.tolist() == [SolverStatus.SOLVED, SolverStatus.NOT_FINITE]
    assert not solution.lam[1].any()
    with pytest.raises(InputError, match="negative"):
        solve_cone_qp(A, c, np.array([-0.5]))
    with pytest.raises(InputError, match="shapes"):
        solve_cone_qp(A[:1], c, np.array([0.5]))
    with pytest.raises(InputError, match="warm start"):
        solve_cone_qp(A, c, np.array([0.5]), warm=np.zeros(3))
