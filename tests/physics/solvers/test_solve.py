"""Batches of contact problems: warm starts, threads, and every registered solver."""

from __future__ import annotations

import numpy as np
import pytest

from tests.physics.solvers.contact_problems import draw_many
from tossid.errors import InputError
from tossid.physics.solvers import PolyhedralCone, solve_contacts


def test_warm_start_and_threads() -> None:
    A, b, mu = draw_many(400, 5, ("slide", "flat"))[4]
    cold = solve_contacts(A, b, mu)
    assert cold.unsolved == 0
    np.testing.assert_array_equal(solve_contacts(A, b, mu, warm=cold.lam).lam, cold.lam)
    np.testing.assert_array_equal(solve_contacts(A, b, mu, n_threads=2).lam, cold.lam)


def test_the_solver_is_chosen_by_its_settings() -> None:
    """Without friction all cones are one, and several directions change nothing."""
    A, b, mu = draw_many(300, 2, ("frictionless",))[4]
    found = [solve_contacts(A, b, mu, solver=PolyhedralCone(4), tolerance=1e-8), solve_contacts(A, b, mu)]
    assert not any(each.unsolved for each in found)
    w = [np.einsum("bij,bj->bi", A, each.lam) for each in found]
    np.testing.assert_allclose(w[0], w[1], atol=1e-7)
    with pytest.raises(InputError, match="n_directions is 5"):
        solve_contacts(A, b, mu, solver=PolyhedralCone(5))
