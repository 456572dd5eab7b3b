import numpy as np
import pytest

from tossid.motion.momentum.estimate import momentum_balance
from tossid.physics.identifiable import inertia_error
from tossid.rotations import quat_to_matrix


@pytest.mark.slow
def test_inertia_and_friction_of_an_uneven_start(wedge):
    I = wedge.true.inertia
    R = quat_to_matrix(np.array([0.9, 0.3, 0.2, 0.25]) / np.linalg.norm([0.9, 0.3, 0.2, 0.25]))
    start = wedge.true.with_changes(inertia=1.4 * R @ I @ R.T, friction=0.4)
    found = momentum_balance(wedge.tosses, start)
    assert np.linalg.norm(found.inertia - I) < 0.06 * np.linalg.norm(I)
    assert found.inertia_deviation < 0.05
    assert found.friction == pytest.approx(wedge.true.friction, abs=0.01)
    assert found.friction_deviation < 0.01


@pytest.mark.slow
def test_inertia_and_friction_of_two_links_from_an_uneven_start(elbow):
    start = elbow.true.with_changes(inertia=np.array([1.3, 0.8])[:, None, None] * elbow.true.inertia, friction=0.4)
    found = momentum_balance(elbow.tosses, start)
    assert inertia_error(start, elbow.true) > 0.15
    assert inertia_error(elbow.true.with_changes(inertia=found.inertia), elbow.true) < 0.02
    assert found.inertia_deviation < 0.01
    assert found.friction == pytest.approx(elbow.true.friction, abs=0.01)


def test_flight_alone_shows_no_friction(wedge):
    tosses = [toss.frames(slice(20)) for toss in wedge.tosses]
    found = momentum_balance(tosses, wedge.true)
    assert found.friction is None
    assert found.friction_deviation == np.inf
    assert found.inertia_deviation > 0.05  # the absolute size needs a contact


def test_where_the_filter_breaks_down_nothing_is_determined(wedge, monkeypatch):
    def broken(balance, inertia, mu=None):
        return np.linalg.cholesky(-np.eye(6))

    monkeypatch.setattr("tossid.motion.momentum.balance.Balance.residuals", broken)
    found = momentum_balance(wedge.tosses, wedge.true)
    np.testing.assert_array_equal(found.inertia, wedge.true.inertia)
    assert found.inertia_deviation == 0.5
    assert found.friction is None
