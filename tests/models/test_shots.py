"""Shots: what they start from, how far they go, and their errors against simulated truth."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.models.made import DT, tosses
from tossid.models.predictor import Simulator
from tossid.models.shots import first_states, flight_starts, make_shots, make_stretches, prediction_errors, stretches
from tossid.motion import flight_frames
from tossid.objects import ObjectModel, corner_positions
from tossid.physics import make_system
from tossid.settings.training import ModelSettings
from tossid.types import Toss


@pytest.fixture(scope="module")
def made(cube: ObjectModel) -> list[Toss]:
    return tosses(cube, 4, seed=0, substeps=ModelSettings.substeps)


def test_the_simulator_that_made_them_predicts_without_error(cube: ObjectModel, made: list[Toss]) -> None:
    predictor = Simulator(make_system(cube))
    first = first_states(made, cube, predictor, velocity_lag=0.0)
    starts = flight_starts(cube, made, gravity=9.81)
    shots = make_shots(cube, made, horizon=10, first=first, flight=[None] * len(made))
    np.testing.assert_array_equal(shots.n_steps, [min(flight_frames(toss, cube) + 10, 70) for toss in made])
    errors = prediction_errors(predictor, shots)
    assert np.abs(errors).max() < 1e-9
    assert sum(start is not None for start in starts) > 0
    both = make_shots(cube, made, horizon=10, first=first, flight=starts)
    assert len(both.q0) == len(made) + sum(start is not None for start in starts)


def test_errors_are_predicted_minus_measured_in_half_widths(cube: ObjectModel, made: list[Toss]) -> None:
    flight = [toss.frames(slice(0, 6)) for toss in made]
    predictor = Simulator(make_system(cube, gravity=9.81 + 2.0))
    q0, v0 = first_states(flight, cube, predictor, velocity_lag=0.0)
    shots = make_shots(cube, flight, horizon=10, first=(q0, v0), flight=[None] * len(flight))
    k = np.arange(1, 6)
    expected = -2.0 * (DT * k) ** 2 / 2
    errors = prediction_errors(predictor, shots)[..., 2] * 0.5 * cube.width
    np.testing.assert_allclose(errors, np.tile(expected, (4, 1)), rtol=1e-6)


def test_a_state_in_the_ground_is_lifted_and_a_late_velocity_brought_forward(
    cube: ObjectModel, made: list[Toss]
) -> None:
    low = made[0].q[0].copy()
    low[2] = 0.0
    sunk = replace(made[0], q=np.vstack([low, made[0].q[1:]]))
    predictor = Simulator(make_system(cube))
    q, v = first_states([sunk], cube, predictor, velocity_lag=0.01)
    assert corner_positions(cube, q)[..., 2].min() == pytest.approx(0.0, abs=1e-12)
    assert v[0, 2] == pytest.approx(sunk.v[0, 2] - 0.0981)


def test_stretches_cover_a_toss_once(cube: ObjectModel, made: list[Toss]) -> None:
    cut = stretches(made, 20)
    assert [index for index, _ in cut] == [i for i in range(4) for _ in range(3)]
    assert all(len(part) == 21 for _, part in cut)
    shots = make_stretches(cube, made, Simulator(make_system(cube)), steps=20, velocity_lag=0.0)
    assert shots.target.shape == (12, 20, 7)
    np.testing.assert_array_equal(shots.target[1], made[0].q[21:41])


def test_the_shots_of_some_tosses_have_the_errors_that_they_have_among_all(cube: ObjectModel, made: list[Toss]) -> None:
    predictor = Simulator(make_system(cube, gravity=9.0))
    first = first_states(made, cube, predictor, velocity_lag=0.0)
    shots = make_shots(cube, made, horizon=10, first=first, flight=[None] * len(made))
    assert len(shots.in_shares(3)) == 1
    assert [share.toss.tolist() for share in shots.in_shares(1)] == [[0], [2], [1, 3]]
    some, rest = shots.in_shares(2)
    np.testing.assert_array_equal(some.toss, [0, 2])
    np.testing.assert_array_equal(rest.toss, [1, 3])
    errors = prediction_errors(predictor, some)
    np.testing.assert_array_equal(errors, prediction_errors(predictor, shots)[[0, 2], : errors.shape[1]])
