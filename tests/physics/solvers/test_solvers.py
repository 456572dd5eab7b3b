"""The contact solvers: thousands of problems, known answers, and refusals; tests/test_docs.py runs a user's own."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import numpy as np
import pytest

from tests.physics.solvers.contact_problems import INERTIA, MASS, delassus, draw_many, landing
from tests.physics.solvers.reference import (
    ACCEPTED_KKT_ERROR,
    cone_kkt_error,
    cone_qp_kkt_error,
    polyhedral_kkt_error,
    project_cones,
)  # fmt: skip
from tossid.errors import InputError
from tossid.objects import ObjectModel, load_object
from tossid.physics import ExactCone, PolyhedralCone, make_system, register_solver, simulate
from tossid.physics.solvers import ConeProgramme, ContactSolution, SolverStatus, solve_contacts
from tossid.physics.solvers.problem import Array

solve_cone_qp = partial(solve_contacts, solver=ConeProgramme())

WALLS = delassus(np.zeros((2, 3)), np.array([[1.0, 0, 0], [-1.0, 0, 0]]), MASS, np.full(3, INERTIA))[1]
"""Of two opposite walls, which no impulse keeps out if both come in."""


class Solver(NamedTuple):
    """A solver, the plain KKT error of its problem, the tolerance, and the share that it may leave unsolved."""

    solve: Callable[..., ContactSolution]
    kkt_error: Callable[..., Array]
    tolerance: float
    unsolved: float


def polyhedral(k: int) -> Solver:
    solve = partial(solve_contacts, solver=PolyhedralCone(k), tolerance=ACCEPTED_KKT_ERROR)
    return Solver(solve, partial(polyhedral_kkt_error, n_directions=k), 1e-5, 0.02)


SOLVERS = {
    "exact": Solver(solve_contacts, cone_kkt_error, ACCEPTED_KKT_ERROR, 0.012),
    "cone programme": Solver(solve_cone_qp, cone_qp_kkt_error, ACCEPTED_KKT_ERROR, 0.04),
    "polyhedral": polyhedral(4),
    "octagonal": polyhedral(8),
}

each = pytest.mark.parametrize("solver", SOLVERS.values(), ids=list(SOLVERS))


@each
def test_thousands_of_problems_are_solved_or_said_not_to_be(solver: Solver) -> None:
    total, unsolved = 0, 0
    for A, b, mu in draw_many(4_000, 0).values():
        solution = solver.solve(A, b, mu)
        solved = solution.status == SolverStatus.SOLVED
        kkt_error = solver.kkt_error(A, b, mu, solution.lam)
        rounding = 1e-13 * np.einsum("bij,bj->bi", np.abs(A), np.abs(solution.lam)).max(axis=1)
        assert (kkt_error <= solver.tolerance + rounding)[solved].all()
        assert (solution.kkt_error[~solved] > 1e-9).all()
        if solver.solve is not solve_cone_qp:  # whose friction may add energy
            n, w = mu.shape[1], np.einsum("bij,bj->bi", A, solution.lam) + b
            power = np.einsum("bi,bi->b", solution.lam[:, n:], w[:, n:])[solved]
            assert (power <= 1e-8 * (1 + np.abs(solution.lam).max(axis=1)[solved])).all()
        unsolved += solution.unsolved
        total += len(b)
    assert total == 4_000
    assert unsolved / total <= solver.unsolved


def test_a_particle_has_the_closed_form() -> None:
    """A = I / m: lam_n = -m b_n, and friction stops the slip or is mu lam_n against it; or a projection."""
    rng, count, mass, k = np.random.default_rng(2), 500, 0.7, 64
    b, mu = rng.normal(size=(count, 3)), rng.uniform(0, 2, size=(count, 1))
    A = np.tile(np.eye(3) / mass, (count, 1, 1))
    lam, by_programme = solve_contacts(A, b, mu).lam, solve_cone_qp(A, b, mu).lam
    normal, slip = mass * np.maximum(-b[:, 0], 0), np.linalg.norm(b[:, 1:], axis=1)
    friction = np.minimum(mu[:, 0] * normal, mass * slip)
    np.testing.assert_allclose(lam[:, 0], normal, atol=1e-12)
    np.testing.assert_allclose(lam[:, 1:], -(friction / slip)[:, None] * b[:, 1:], atol=1e-9)
    np.testing.assert_allclose(by_programme, [project_cones(-mass * b[i], mu[i]) for i in range(count)], atol=1e-12)
    # many directions: slipping, the impulse is the corner (or edge) that faces the slip, at most half a sector away
    many = solve_contacts(A, b, mu, solver=PolyhedralCone(k)).lam
    np.testing.assert_allclose(many[:, 0], normal, atol=1e-10)
    apart, most = np.linalg.norm(many[:, 1:] - lam[:, 1:], axis=1), mu[:, 0] * normal
    assert (apart <= 2 * np.sin(np.pi / k / 2) * most + 1e-10).all()


@pytest.mark.parametrize("solve", [solve_contacts, solve_cone_qp])
def test_a_warm_start_at_the_answer_stays_and_threads_change_nothing(solve) -> None:  # type: ignore[no-untyped-def]
    A, b, mu = draw_many(400, 6, ("slide", "flat"))[4]
    cold = solve(A, b, mu)
    assert cold.unsolved == 0
    np.testing.assert_array_equal(solve(A, b, mu, warm=cold.lam).lam, cold.lam)
    np.testing.assert_array_equal(solve(A, b, mu, n_threads=2).lam, cold.lam)


@pytest.mark.parametrize(
    ("name", "status"), [("exact", SolverStatus.MAX_ITERATIONS), ("octagonal", SolverStatus.INFEASIBLE)]
)
def test_walls_that_close_on_each_other_and_bad_numbers_are_reported(name: str, status: SolverStatus) -> None:
    b = np.array([[-1.0, -1.0, 0, 0, 0, 0], [np.inf, 0, 0, 0, 0, 0], [-1.0, 1.0, 0.3, 0, 0, 0]])
    solution = SOLVERS[name].solve(np.stack([WALLS] * 3), b, np.array([0.3, 0.3]))
    assert solution.status.tolist() == [status, SolverStatus.NOT_FINITE, SolverStatus.SOLVED]
    assert solution.kkt_error[0] > 0.1
    assert not solution.lam[1].any()
    assert solution.unsolved == 2


def test_cone_programmes_solve_what_the_quick_solver_leaves(cube: ObjectModel) -> None:
    """With two iterations nearly nothing is solved at once; the programmes before it bring the answer near."""
    system, (q, v) = make_system(cube), landing(cube, np.random.default_rng(5), 300, tilt=3e-3)
    full, short, alone = (
        simulate(system, q, v, n_steps=1, dt=1 / 148, tolerance=1e-10, solver=solver)
        for solver in (ExactCone(), ExactCone(2, 8), ExactCone(2, 0))
    )
    assert full.unsolved.sum() <= 3
    assert alone.unsolved.sum() > 270
    assert short.unsolved.sum() <= 6
    assert (short.kkt_error <= alone.kkt_error).all()
    assert short.kkt_error[short.unsolved == 0].max() <= 1e-10


class Unregistered(NamedTuple):
    sweeps: int = 1


def solve(solver: Any, A: Any, b: Any, mu: Any, lam: Any, tolerance: float) -> tuple[int, float]:
    return SolverStatus.SOLVED, 0.0


@pytest.mark.parametrize(
    ("call", "says"),
    [
        *(
            (lambda solve=solve: solve(np.eye(3)[None], np.array([[-1.0, 0, 0]]), np.array([-0.5])), "negative")
            for solve in (solve_contacts, solve_cone_qp)
        ),
        (lambda: solve_contacts(np.eye(3)[None], np.zeros((2, 3)), np.array([0.5])), "shapes"),
        (lambda: solve_contacts(np.eye(3)[None], np.zeros((1, 3)), np.array([0.5]), warm=np.zeros(3)), "warm start"),
        (lambda: tossed(Unregistered()), r"Unregistered\(sweeps=1\) is no registered contact solver; there are Cone"),
        (lambda: tossed(ExactCone), "ExactCone'> is no registered contact solver"),
        (lambda: tossed(PolyhedralCone(5)), "n_directions is 5, expected an even number from 4"),
        (lambda: tossed(PolyhedralCone(2)), "expected an even number from 4"),
        (lambda: PolyhedralCone(8).check(relaxed=True), "needs the solver ExactCone"),
        (lambda: register_solver(ExactCone)(solve), "ExactCone has a contact solver already"),
        (lambda: register_solver(dict)(solve), r"class 'dict'>, expected a NamedTuple class"),
        (
            lambda: register_solver(Unregistered)(lambda A, b: (0, 0.0)),
            r"takes \(A, b\), expected \(solver, A, b, mu, lam, tolerance\)",
        ),
    ],
)
def test_what_is_no_problem_or_no_solver_is_refused(call: Callable[[], object], says: str) -> None:
    with pytest.raises(InputError, match=says):
        call()


def tossed(solver: Any) -> None:
    cube = load_object("cube")
    simulate(make_system(cube), *landing(cube, np.random.default_rng(0), 2), n_steps=1, dt=1 / 148, solver=solver)
