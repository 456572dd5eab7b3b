"""First states of flights are kept until the model has changed."""

from __future__ import annotations

import numpy as np
import pytest

from tests.models.made import tosses
from tossid.objects import ObjectModel
from tossid.settings.training import RolloutSettings
from tossid.training.flights import Flights, fit_flights


@pytest.fixture(scope="module")
def flights(cube: ObjectModel) -> Flights:
    made = tosses(cube, 6, seed=2)
    return fit_flights(cube, (made[:4], made[4:]), 9.81, RolloutSettings())


def test_first_states_are_those_that_were_thrown(cube: ObjectModel, flights: Flights) -> None:
    made = tosses(cube, 6, seed=2)
    assert [len(each) for each in flights.fitted] == [4, 2]
    states = [state for each in flights.fitted for state in each]
    assert any(state is not None for state in states)
    for toss, state in zip(made, states, strict=True):
        if state is not None:
            np.testing.assert_allclose(state.v, toss.v[0], atol=0.05)


def test_they_are_outdated_by_what_they_depend_on(cube: ObjectModel, flights: Flights) -> None:
    assert not flights.outdated(cube.with_changes(friction=0.5, corner_pos=1.1 * cube.corner_pos), 9.81)
    assert not flights.outdated(cube.with_changes(inertia=1.005 * cube.inertia), 9.815)
    assert flights.outdated(cube.with_changes(inertia=1.02 * cube.inertia), 9.81)
    assert flights.outdated(cube.with_changes(com=cube.com + np.array([1e-3, 0, 0])), 9.81)
    assert flights.outdated(cube, 9.7)
