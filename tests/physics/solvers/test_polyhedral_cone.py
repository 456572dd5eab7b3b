"""The polyhedral cone in the time stepper."""

from __future__ import annotations

import numpy as np
import pytest

from tests.physics.solvers.contact_problems import landing
from tossid.errors import InputError
from tossid.objects import ObjectModel
from tossid.physics import ExactCone, PolyhedralCone, make_system, simulate


def test_four_corners_at_rest_are_solved_in_the_stepper(cube: ObjectModel) -> None:
    """Rank 6 of 12: pivoting alone ended in singular bases here, once in 230 steps of real tosses."""
    rng = np.random.default_rng(0)
    q, v = np.zeros((60, 7)), rng.normal(size=(60, 6)) * [1, 1, 0.3, 2, 2, 2]
    q[:, 2] = rng.uniform(0.08, 0.15, 60)
    q[:, 3:] = rng.normal(size=(60, 4))
    q[:, 3:] /= np.linalg.norm(q[:, 3:], axis=1, keepdims=True)
    run = simulate(make_system(cube), q, v, n_steps=100, dt=1 / 148, solver=PolyhedralCone(8))
    assert ((run.lam_n > 0).sum(axis=2) == 4).any()
    assert run.unsolved.sum() == 0
    assert run.kkt_error.max() <= 1e-7


def test_many_directions_tend_to_the_exact_cone(cube: ObjectModel) -> None:
    """One step from states with one or two corners on the ground: the friction's direction gets finer."""
    system, (q, v) = make_system(cube), landing(cube, np.random.default_rng(1), 60)
    exact = simulate(system, q, v, n_steps=1, dt=1 / 148, tolerance=1e-10, solver=ExactCone())
    few = (exact.lam_n > 0).sum(axis=2)[:, 0]
    assert ((few == 1) | (few == 2)).sum() > 10
    errors = []
    for k in (4, 8, 16):
        run = simulate(system, q, v, n_steps=1, dt=1 / 148, tolerance=1e-8, solver=PolyhedralCone(k))
        assert run.unsolved.sum() == 0
        errors.append(float(np.abs(run.v - exact.v)[(few > 0) & (few < 3), 1].mean()))
    assert errors[1] < 0.6 * errors[0]
    assert errors[2] < 0.6 * errors[1]
    assert errors[2] < 0.15


@pytest.mark.parametrize(("solver", "relaxed", "says"), [
    (PolyhedralCone(5), False, "n_directions is 5"),
    (PolyhedralCone(2), False, "an even number from 4"),
    (PolyhedralCone(8), True, "needs the solver ExactCone"),
])  # fmt: skip
def test_settings_that_it_cannot_take_are_refused(solver: PolyhedralCone, relaxed: bool, says: str) -> None:
    with pytest.raises(InputError, match=says):
        solver.check(relaxed)
