"""How an answer is judged: projections, and KKT errors that are zero exactly at a solution."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from tests.physics.solvers.contact_problems import draw, draw_many
from tests.physics.solvers.reference import by_contact, cone_kkt_error, cone_qp_kkt_error, contact_scale, project_cone
from tossid.physics.solvers import solve_cone_qp, solve_contacts
from tossid.physics.solvers.problem import contact_rows

number = st.floats(-3, 3)


@given(st.tuples(number, number, number), st.floats(0, 2), st.tuples(st.floats(0, 3), st.floats(0, 1), st.floats(0, 7)))
@example((1.0, 2.2250738585e-313, 0.0), 1.0, (0.0, 0.0, 0.0))
def test_the_projection_is_the_nearest_point_of_the_cone(
    x: tuple[float, ...], mu: float, other: tuple[float, float, float]
) -> None:
    nearest = project_cone(np.array(x), np.array(mu))
    assert np.hypot(nearest[1], nearest[2]) <= mu * nearest[0] + 1e-12
    np.testing.assert_allclose(project_cone(nearest, np.array(mu)), nearest, atol=1e-12)
    size, share, angle = other
    point = size * np.array([1.0, mu * share * np.cos(angle), mu * share * np.sin(angle)])
    assert np.linalg.norm(nearest - x) <= np.linalg.norm(point - x) + 1e-12


def test_rows_of_a_contact() -> None:
    lam = np.arange(12.0)
    for i in range(4):
        np.testing.assert_array_equal(by_contact(lam)[i], lam[contact_rows(i, 4)])


@pytest.mark.parametrize(("solve", "kkt_error"), [(solve_contacts, cone_kkt_error), (solve_cone_qp, cone_qp_kkt_error)])
def test_the_error_is_zero_at_a_solution_and_only_there(solve, kkt_error) -> None:  # type: ignore[no-untyped-def]
    A, b, mu = draw_many(200, 11, ("point", "edge"))[2]
    found = solve(A, b, mu, tolerance=1e-12)
    good = found.status == 0
    loaded = good & (found.lam[:, :2].sum(axis=1) > 1e-3)
    assert loaded.sum() > 20
    assert kkt_error(A, b, mu, found.lam)[good].max() <= 1e-11
    assert kkt_error(A, b, mu, 1.01 * found.lam)[loaded].min() > 1e-6


def test_a_heavier_body_keeps_its_error() -> None:
    """Impulses grow with mass, and the error stays a velocity."""
    A, b, mu = draw("flat", np.random.default_rng(0), mu=0.3)
    lam = np.random.default_rng(1).normal(size=12)
    for error in (cone_kkt_error, cone_qp_kkt_error):
        assert error(A / 50, b, mu, 50 * lam) == pytest.approx(error(A, b, mu, lam), rel=1e-12)
    np.testing.assert_allclose(contact_scale(A / 50), contact_scale(A) / 50)
