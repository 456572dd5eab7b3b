"""First states of flights are kept until the model has changed; flights show the body and gravity."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.models.made import tosses
from tossid.models import variant
from tossid.models.contactnets import ContactNets
from tossid.objects import ObjectModel
from tossid.rotations import quat_exp, quat_mul, quat_normalize
from tossid.settings.training import ModelSettings, TrainSettings
from tossid.training.fit import Fit
from tossid.training.flights import FlightStage, first_states_of_flights
from tossid.types import Toss


def test_first_states_are_outdated_by_what_they_depend_on(cube: ObjectModel) -> None:
    made = tosses(cube, 6, seed=2)
    flights = first_states_of_flights(cube, (made[:4], made[4:]), 9.81)
    assert [len(each) for each in flights.states] == [4, 2]
    assert not flights.outdated(cube.with_changes(friction=0.5, corner_pos=1.1 * cube.corner_pos), 9.81)
    assert not flights.outdated(cube.with_changes(inertia=1.005 * cube.inertia), 9.815)
    assert flights.outdated(cube.with_changes(inertia=1.02 * cube.inertia), 9.81)
    assert flights.outdated(cube.with_changes(com=cube.com + np.array([1e-3, 0, 0])), 9.81)
    assert flights.outdated(cube, 9.7)


def measured(thrown: list[Toss]) -> list[Toss]:
    """The tosses with 0.05 mm and 0.5 mrad of noise, as stated."""
    rng, cov = np.random.default_rng(0), np.diag([5e-5] * 3 + [5e-4] * 3) ** 2
    found = []
    for toss in thrown:
        noise, q = rng.multivariate_normal(np.zeros(6), cov, len(toss)), toss.q.copy()
        q[:, :3] += noise[:, :3]
        q[:, 3:7] = quat_normalize(quat_mul(q[:, 3:7], quat_exp(noise[:, 3:])))
        found.append(replace(toss, q=q, q_cov=np.broadcast_to(cov, (len(toss), 6, 6)).copy()))
    return found


def flight_stage(start: ObjectModel, cube: ObjectModel, settings: ModelSettings) -> tuple[ContactNets, FlightStage]:
    """The stage and its model, from a start, on tosses of the cube; begun."""
    model, made = ContactNets(start, settings), measured(tosses(cube, 32, seed=5))
    stage = FlightStage(model.stages()[0], model, (made[:24], made[24:]), TrainSettings())
    stage.begin()
    return model, stage


def test_flight_shows_centre_of_mass_ratios_of_inertia_and_gravity(cube: ObjectModel) -> None:
    start = cube.with_changes(
        com=cube.com + np.array([4e-3, -6e-3, 2e-3]), inertia=cube.inertia * np.array([1.3, 1.0, 0.9])[:, None]
    )
    model, stage = flight_stage(start, cube, replace(variant("cnrpi"), gravity=2.0))
    before = stage.validation_loss()
    while not stage.step().done:
        pass
    mechanics = model.mechanics()
    moments = np.diag(mechanics.object.inertia[0])
    assert mechanics.carried_gravity == pytest.approx(9.81, abs=0.03)
    np.testing.assert_allclose(mechanics.object.com, cube.com, atol=1e-3)
    np.testing.assert_allclose(moments / moments.mean(), 1.0, atol=0.03)
    assert stage.validation_loss() < before


def test_the_size_of_inertia_is_left_where_it_was(cube: ObjectModel) -> None:
    model, stage = flight_stage(cube.with_changes(inertia=2 * cube.inertia), cube, variant("cnrpi"))
    for _ in range(3):
        stage.step()
    assert np.trace(model.learned_object().inertia[0]) == pytest.approx(2 * np.trace(cube.inertia[0]), rel=0.01)


def test_a_body_that_validation_flights_contradict_is_undone(cube: ObjectModel) -> None:
    wrong = cube.with_changes(com=cube.com + np.array([0.0, 5e-3, 0.0]))
    model = ContactNets(cube, replace(variant("cnrpi"), horizons=(), implicit=False, gravity=0.0))
    fit = Fit(model, measured(tosses(wrong, 3, seed=6)), measured(tosses(cube, 3, seed=7)))
    stages = [record.stage for record in fit.epochs()]
    assert stages[0] == "flight"
    np.testing.assert_array_equal(model.learned_object().com, cube.com)
    assert model.flight_gravity(fit.transitions[1]) == pytest.approx(9.81, abs=0.15)
