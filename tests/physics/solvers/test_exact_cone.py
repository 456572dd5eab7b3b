"""The exact cone in the time stepper: what the quick solver leaves is solved again."""

from __future__ import annotations

import numpy as np

from tests.physics.solvers.contact_problems import landing
from tossid.objects import ObjectModel
from tossid.physics import ExactCone, make_system, simulate


def test_cone_programmes_solve_what_the_quick_solver_leaves(cube: ObjectModel) -> None:
    """With two iterations nearly nothing is solved at once; the programmes before it bring the answer near."""
    system, (q, v) = make_system(cube), landing(cube, np.random.default_rng(5), 300, tilt=3e-3)

    def landed(solver: ExactCone):  # type: ignore[no-untyped-def]
        return simulate(system, q, v, n_steps=1, dt=1 / 148, tolerance=1e-10, solver=solver)

    full, short, alone = landed(ExactCone()), landed(ExactCone(2, 8)), landed(ExactCone(2, 0))
    assert full.unsolved.sum() <= 3
    assert alone.unsolved.sum() > 270
    assert short.unsolved.sum() <= 6
    assert (short.kkt_error <= alone.kkt_error).all()
    assert short.kkt_error[short.unsolved == 0].max() <= 1e-10
