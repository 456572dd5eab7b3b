"""A contact solver of a user's own: registered from here, used in a toss, and refused where it is misused."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import pytest

from tests.physics.solvers.contact_problems import draw_many, landing
from tossid.errors import InputError
from tossid.objects import ObjectModel
from tossid.physics import ExactCone, PolyhedralCone, make_system, register_solver, simulate
from tossid.physics.solvers import SolverStatus, solve_contacts
from tossid.physics.solvers.cone import cone_solve
from tossid.physics.solvers.workspace import TOP, gather, gather_matrix, scatter, work_arrays


class FromZero(NamedTuple):
    """The exact cone without the last step's impulses, which a limit on the iterations cuts short."""

    max_iterations: int = 60


@register_solver(FromZero)
def _from_zero(solver: FromZero, A: Any, b: Any, mu: Any, lam: Any, tolerance: float) -> tuple[int, float]:
    n = len(mu)
    work, index = work_arrays(n)
    lam[:] = 0.0
    gather(b, mu, lam, work)
    local = work[TOP + 3 * n :]
    gather_matrix(A, local, n)
    status, kkt_error, _ = cone_solve(local, work, index, n, tolerance, solver.max_iterations)
    scatter(lam, work, n, status)
    if status != 0:
        return SolverStatus.INACCURATE, kkt_error
    return SolverStatus.SOLVED, kkt_error


def test_a_registered_solver_solves_problems_like_the_exact_cone() -> None:
    A, b, mu = draw_many(300, 2, ("slide", "point"))[1]
    own, exact = (solve_contacts(A, b, mu, solver=solver, tolerance=1e-11) for solver in (FromZero(), ExactCone()))
    assert own.unsolved == 0
    np.testing.assert_allclose(own.lam, exact.lam, atol=1e-9)
    cut_short = solve_contacts(A, b, mu, solver=FromZero(0), tolerance=1e-11)
    assert (cut_short.status == SolverStatus.INACCURATE).any()


@pytest.mark.slow
def test_a_registered_solver_tosses_like_the_exact_cone(cube: ObjectModel) -> None:
    """A step's problem reaches it row for row: its impulses are those that the library's solver finds."""
    system, (q, v) = make_system(cube), landing(cube, np.random.default_rng(0), 20)
    own, exact = (
        simulate(system, q, v, n_steps=10, dt=1 / 148, tolerance=1e-11, solver=solver)
        for solver in (FromZero(), ExactCone())
    )
    assert own.unsolved.sum() == 0
    assert (own.lam_n > 0).any(axis=(1, 2)).mean() > 0.8
    # three corners or more share their load in many ways
    unique = np.cumsum((exact.lam_n > 0).sum(axis=2) > 2, axis=1) == 0
    assert unique.mean() > 0.6
    np.testing.assert_allclose(own.q[:, 1:][unique], exact.q[:, 1:][unique], atol=1e-9)
    np.testing.assert_allclose(own.lam_n[unique], exact.lam_n[unique], atol=1e-9)
    cut_short = simulate(system, q, v, n_steps=10, dt=1 / 148, tolerance=1e-11, solver=FromZero(1))
    assert cut_short.unsolved.sum() > 0
    assert cut_short.kkt_error.max() > 1e-11


class Unregistered(NamedTuple):
    sweeps: int = 1


@pytest.mark.parametrize(
    ("solver", "says"),
    [
        (Unregistered(), r"Unregistered\(sweeps=1\) is no registered contact solver; there are ExactCone, From"),
        (ExactCone, "ExactCone'> is no registered contact solver"),
        (PolyhedralCone(5), "n_directions is 5, expected an even number from 4"),
    ],
)  # fmt: skip
def test_what_is_no_solver_is_refused_before_the_simulation(cube: ObjectModel, solver: Any, says: str) -> None:
    with pytest.raises(InputError, match=says):
        simulate(make_system(cube), *landing(cube, np.random.default_rng(0), 2), n_steps=1, dt=1 / 148, solver=solver)


def test_what_cannot_be_a_solver_is_refused_when_it_is_registered() -> None:
    with pytest.raises(InputError, match="FromZero has a contact solver already"):
        register_solver(FromZero)(lambda solver, A, b, mu, lam, tolerance: (0, 0.0))
    with pytest.raises(InputError, match=r"class 'dict'>, expected a NamedTuple class"):
        register_solver(dict)
    with pytest.raises(InputError, match=r"takes \(A, b\), expected \(solver, A, b, mu, lam, tolerance\)"):
        register_solver(Unregistered)(lambda A, b: (0, 0.0))
