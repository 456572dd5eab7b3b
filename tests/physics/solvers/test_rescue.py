"""Second tries: the better answer is kept, whatever the attempts come to."""

from __future__ import annotations

import numpy as np

from tests.physics.solvers.contact_problems import draw
from tossid.physics.solvers import SolverStatus, solve_cone_qp
from tossid.physics.solvers.problem import Array, cone_kkt_error
from tossid.physics.solvers.rescue import interior_start, rescue_cone, rescue_programme


def test_the_interior_point_s_start_is_near_the_minimum_and_leaves_others_at_zero() -> None:
    A, c, mu = draw("flat", np.random.default_rng(0), mu=0.3)
    active = np.array([True, False, True, True])
    start = interior_start(A, c, mu, active, 1e-3)
    best = solve_cone_qp(A[None], c[None], mu, active=active[None], regularization=1e-3).lam[0]
    np.testing.assert_allclose(start, best, atol=1e-5 * (1 + np.abs(best).max()))
    assert not start[[1, 6, 7]].any()


def test_a_programme_s_worse_answer_is_not_taken() -> None:
    lam = np.ones(3)

    def attempt(warm: Array, limit: int) -> tuple[int, float, int]:
        warm[:] = 7.0
        return SolverStatus.MAX_ITERATIONS, 0.5, limit

    assert rescue_programme(np.zeros(3), attempt, lam, 0.1) == (SolverStatus.MAX_ITERATIONS, 0.1)
    np.testing.assert_array_equal(lam, 1.0)
    assert rescue_programme(np.zeros(3), attempt, lam, 0.9) == (SolverStatus.MAX_ITERATIONS, 0.5)
    np.testing.assert_array_equal(lam, 7.0)


def test_a_sequence_of_programmes_comes_to_the_exact_cone() -> None:
    """Here an attempt only measures: the iteration on |w_t| alone finds the answer."""
    A, b, mu = draw("edge", np.random.default_rng(6), mu=0.18)
    lam = np.zeros(6)

    def programme(c: Array, warm: Array) -> None:
        warm[:] = solve_cone_qp(A[None], c[None], mu, warm=warm[None], tolerance=1e-12).lam[0]

    def attempt(warm: Array, limit: int) -> tuple[int, float, int]:
        error = float(cone_kkt_error(A, b, mu, warm))
        return (SolverStatus.SOLVED if error < 1e-7 else SolverStatus.MAX_ITERATIONS), error, limit

    before = float(cone_kkt_error(A, b, mu, lam))
    assert before > 0.01
    status, kkt_error = rescue_cone(A, b, mu, lam, before, polyhedral=lam, programme=programme, attempt=attempt)
    assert status == SolverStatus.SOLVED
    assert cone_kkt_error(A, b, mu, lam) == kkt_error < 1e-7
