"""The contact solvers: thousands of problems, known answers, a plain reference, and solvers of a user's own."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import numpy as np
import pytest

from tests.physics.solvers.contact_problems import INERTIA, MASS, delassus, draw, draw_many, landing  # fmt: skip
from tests.physics.solvers.reference import (
    ACCEPTED_KKT_ERROR,
    cone_kkt_error,
    cone_qp_kkt_error,
    cone_qp_reference,
    cone_reference,
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
    "exact": Solver(solve_contacts, cone_kkt_error, ACCEPTED_KKT_ERROR, 0.01),
    "cone programme": Solver(solve_cone_qp, cone_qp_kkt_error, ACCEPTED_KKT_ERROR, 0.04),
    "polyhedral": polyhedral(4),
    "octagonal": polyhedral(8),
}


each = pytest.mark.parametrize("solver", SOLVERS.values(), ids=list(SOLVERS))


@each
def test_thousands_of_problems_are_solved_or_said_not_to_be(solver: Solver) -> None:
    total, unsolved = 0, 0
    for A, b, mu in draw_many(10_000, 0).values():
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
    assert total == 10_000
    assert unsolved / total <= solver.unsolved


@pytest.mark.parametrize("family", ["slide", "edge", "point", "vee"])
def test_the_exact_cone_agrees_with_the_reference(family: str) -> None:
    rng, compared = np.random.default_rng(4), 0
    for _ in range(6):
        A, b, mu = draw(family, rng, mu=0.18)
        lam, kkt_error = cone_reference(A, b, mu, tolerance=1e-7, turns=20)
        if kkt_error <= 1e-7:
            np.testing.assert_allclose(A @ solve_contacts(A[None], b[None], mu).lam[0], A @ lam, atol=1e-5)
            compared += 1
    assert compared >= 4


@pytest.mark.parametrize("family", ["rest", "slide", "edge", "point", "duplicate", "vee", "random"])
def test_the_cone_programme_agrees_with_the_reference(family: str) -> None:
    rng, solved = np.random.default_rng(2), 0
    for _ in range(6):
        A, c, mu = draw(family, rng)
        lam, kkt_error = cone_qp_reference(A, c, mu, tolerance=1e-8, max_iterations=20_000)
        fast = solve_cone_qp(A[None], c[None], mu)
        if fast.unsolved:
            continue
        solved += 1
        # The minimum and A lam are unique, lam need not be.
        best, found = (0.5 * x @ A @ x + c @ x for x in (lam, fast.lam[0]))
        assert found <= best + 1e-13
        if kkt_error <= 1e-8:
            np.testing.assert_allclose(A @ fast.lam[0], A @ lam, atol=2e-4 * (1 + np.abs(c).max()))
            assert found == pytest.approx(best, abs=1e-8)
    assert solved >= 5


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


def test_many_directions_tend_to_the_exact_cone(cube: ObjectModel) -> None:
    """One step from states with one or two corners on the ground: the friction's direction gets finer."""
    system, (q, v) = make_system(cube), landing(cube, np.random.default_rng(1), 60)
    exact = simulate(system, q, v, n_steps=1, dt=1 / 148, tolerance=1e-10)
    few = np.isin((exact.lam_n > 0).sum(axis=2)[:, 0], (1, 2))
    assert few.sum() > 10
    errors = []
    for k in (4, 8, 16):
        run = simulate(system, q, v, n_steps=1, dt=1 / 148, tolerance=1e-8, solver=PolyhedralCone(k))
        assert run.unsolved.sum() == 0
        errors.append(float(np.abs(run.v - exact.v)[few, 1].mean()))
    assert errors[1] < 0.6 * errors[0]
    assert errors[2] < min(0.6 * errors[1], 0.15)


class Sweeps(NamedTuple):
    """Projected Gauss-Seidel from no impulse."""

    most: int = 5000


@register_solver(Sweeps)
def sweep(solver: Sweeps, A: Any, b: Any, mu: Any, lam: Any, tolerance: float) -> tuple[int, float]:
    n, change = len(mu), np.inf
    lam[:] = 0.0
    for _ in range(solver.most):
        change = 0.0
        for i in range(n):
            t, u = n + 2 * i, n + 2 * i + 1
            before = lam[i], lam[t], lam[u]
            lam[i] = max(lam[i] - (A[i] @ lam + b[i]) / A[i, i], 0.0)
            across = A[t, t] + A[u, u]
            x, y = lam[t] - (A[t] @ lam + b[t]) / across, lam[u] - (A[u] @ lam + b[u]) / across
            share = min(1.0, mu[i] * lam[i] / max(np.hypot(x, y), 1e-300))
            lam[t], lam[u] = share * x, share * y
            slip = across * np.hypot(lam[t] - before[1], lam[u] - before[2])
            change = max(change, A[i, i] * abs(lam[i] - before[0]), slip)
        if change <= tolerance:
            return SolverStatus.SOLVED, change
    return SolverStatus.INACCURATE, change


def test_a_registered_solver_solves_problems_like_the_exact_cone() -> None:
    A, b, mu = draw_many(300, 2, ("slide", "point"))[1]
    own, exact = (solve_contacts(A, b, mu, solver=solver, tolerance=1e-12) for solver in (Sweeps(), ExactCone()))
    assert own.unsolved == 0
    np.testing.assert_allclose(own.lam, exact.lam, atol=1e-9)
    assert (solve_contacts(A, b, mu, solver=Sweeps(1)).status == SolverStatus.INACCURATE).any()


@pytest.mark.slow
def test_a_registered_solver_tosses_like_the_exact_cone(cube: ObjectModel) -> None:
    """A step's problem reaches it row for row: its impulses are those that the library's solver finds."""
    system, (q, v) = make_system(cube), landing(cube, np.random.default_rng(0), 20)
    own, exact, short = (
        simulate(system, q, v, n_steps=10, dt=1 / 148, tolerance=1e-12, solver=solver)
        for solver in (Sweeps(), ExactCone(), Sweeps(2))
    )
    # three corners or more share their load in many ways
    unique = np.cumsum((exact.lam_n > 0).sum(axis=2) > 2, axis=1) == 0
    assert (own.lam_n > 0).any(axis=(1, 2)).mean() > 0.8
    assert unique.mean() > 0.6
    np.testing.assert_allclose(own.q[:, 1:][unique], exact.q[:, 1:][unique], atol=1e-8)
    np.testing.assert_allclose(own.lam_n[unique], exact.lam_n[unique], atol=1e-8)
    assert short.unsolved.sum() > 0


class Unregistered(NamedTuple):
    sweeps: int = 1


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
        (lambda: register_solver(Sweeps)(sweep), "Sweeps has a contact solver already"),
        (lambda: register_solver(dict)(sweep), r"class 'dict'>, expected a NamedTuple class"),
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
