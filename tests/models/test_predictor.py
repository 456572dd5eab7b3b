"""What predicts, and what it is trained on: transitions, shots, how far these go, and their errors."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import torch

from tests.models.made import DT, flights, thrown, tosses
from tossid.models.e2e import EndToEnd
from tossid.models.predictor import Simulator
from tossid.models.shots import Shots, first_states, make_shots, make_stretches, prediction_errors, stretches
from tossid.models.transitions import make_transitions
from tossid.motion import frames_in_flight
from tossid.objects import ObjectModel, corner_positions
from tossid.physics import make_system, simulate
from tossid.rotations import quat_boxminus, quat_normalize
from tossid.settings.training import ModelSettings
from tossid.types import Toss


@pytest.mark.parametrize(("yielding", "parts"), [({}, 8), ({"compliance": 1e-4, "relaxation": 1e-3}, 1)])
def test_impacts_happen_where_they_are_or_where_they_last_where_steps_end(
    cube: ObjectModel, yielding: dict[str, float], parts: int
) -> None:
    system, (q, v) = make_system(cube.with_changes(**yielding)), thrown(np.random.default_rng(0), 3)
    found = Simulator(system, substeps=4).rollout(q, v, n_steps=60, dt=DT)
    expected = simulate(system, q, v, n_steps=60, dt=DT, substeps=4, impact_parts=parts)
    np.testing.assert_array_equal(found.q, expected.q)
    assert np.abs(found.q - Simulator(system, substeps=1).rollout(q, v, n_steps=60, dt=DT).q).max() > 1e-6


def test_acceleration_is_gravity_and_eulers_equations(cube: ObjectModel) -> None:
    inertia = np.diag([1e-3, 2e-3, 2.5e-3])[None]
    simulator = Simulator(make_system(cube.with_changes(inertia=inertia, com=np.zeros((1, 3))), gravity=9.0))
    q, v = thrown(np.random.default_rng(1), 5)
    found = simulator.acceleration(q, v)
    np.testing.assert_allclose(found[:, :3], np.tile([0, 0, -9.0], (5, 1)), atol=1e-12)
    spin = v[:, 3:]
    expected = -np.cross(spin, spin @ inertia[0]) / np.diag(inertia[0])
    np.testing.assert_allclose(found[:, 3:], expected, atol=1e-9)


def test_its_loss_is_the_error_of_the_next_velocity(cube: ObjectModel) -> None:
    made = tosses(cube, 2, seed=0, frames=8)
    data, network = make_transitions(cube, made), EndToEnd(cube, hidden=4, seed=1)
    expected = []
    for toss in made:
        a = network.simulator().acceleration(toss.q[:-1], toss.v[:-1])
        error = np.diff(toss.v, axis=0) - DT * a
        expected += list((error[:, :3] ** 2).sum(1) + ((0.5 * cube.width * error[:, 3:]) ** 2).sum(1))
    assert float(network.loss(data)[0].detach()) == pytest.approx(np.mean(expected), rel=1e-6)


def test_a_rollout_that_diverges_is_reported(cube: ObjectModel) -> None:
    network = EndToEnd(cube, hidden=4)
    with torch.no_grad():
        network.biases[-1].fill_(1e8)
    q, v = thrown(np.random.default_rng(0), 2)
    run = network.simulator().rollout(q, v, n_steps=np.array([5, 3]), dt=DT)
    assert not run.finite.any()
    assert np.isfinite(run.q).all()


# ---------------------------------------------------------------- shots


@pytest.fixture(scope="module")
def made(cube: ObjectModel) -> list[Toss]:
    return tosses(cube, 4, seed=0, substeps=ModelSettings.substeps)


@pytest.mark.parametrize("noise", [0.0, 2e-3])
def test_frames_in_the_hand_are_not_flight(cube: ObjectModel, elbow: ObjectModel, noise: float) -> None:
    """Of links that swing the base accelerates by anything; their common centre of mass falls."""
    assert len(make_transitions(elbow, flights(elbow, 8)).flight) == 8 * 30
    free = flights(cube, 8, noise=noise)
    assert len(make_transitions(cube, free).flight) == 8 * 30
    at_rest_first = 9.81 * DT * (np.arange(31) > 0)[:, None] * np.eye(6)[2]
    found = make_transitions(cube, [replace(toss, v=toss.v + at_rest_first) for toss in free])
    assert len(found.flight) == 8 * 29
    fall = found.in_flight().dv[:, 2] / found.in_flight().dt
    assert float(fall.mean()) == pytest.approx(-9.81, abs=1e-6 + 30 * noise)


def shots_of(model: ObjectModel, made: list[Toss], predictor: Simulator, **keys: Any) -> Shots:
    first = first_states(made, model, predictor, velocity_lag=0.0)
    return make_shots(model, made, horizon=10, first=first, **{"flight": [None] * len(made), **keys})


def test_the_simulator_that_made_them_predicts_without_error(cube: ObjectModel, made: list[Toss]) -> None:
    shots = shots_of(cube, made, Simulator(make_system(cube)))
    np.testing.assert_array_equal(shots.n_steps, [min(frames_in_flight([toss], cube)[0] + 10, 70) for toss in made])
    assert np.abs(prediction_errors(Simulator(make_system(cube)), shots)).max() < 1e-9
    start: Any = SimpleNamespace(q=made[1].q[0], v=made[1].v[0])
    both = shots_of(cube, made, Simulator(make_system(cube)), flight=[None, start, None, None])
    assert both.toss.tolist() == [0, 1, 1, 2, 3]


def test_errors_have_rotation_vectors_and_joints_and_end_with_their_shot() -> None:
    rng = np.random.default_rng(0)
    q, target = rng.normal(size=(5, 9, 9)), rng.normal(size=(5, 8, 9))
    q[..., 3:7], target[..., 3:7] = quat_normalize(q[..., 3:7]), quat_normalize(target[..., 3:7])
    q[0, 1, 3:7] = target[0, 0, 3:7]  # no rotation at all
    shots = Shots(q[:, 0], np.zeros((5, 8)), np.array([8, 3, 1, 8, 5]), target, np.arange(5), DT, 0.05)
    predictor: Any = SimpleNamespace(rollout=lambda *_, **__: SimpleNamespace(q=q))
    turned = quat_boxminus(q[:, 1:, 3:7], target[..., 3:7])
    parts = [(q[:, 1:, :3] - target[..., :3]) / 0.05, turned, q[:, 1:, 7:] - target[..., 7:]]
    expected = np.concatenate(parts, axis=-1)
    expected[np.arange(8) >= shots.n_steps[:, None]] = 0.0
    np.testing.assert_allclose(prediction_errors(predictor, shots), expected, rtol=1e-12, atol=1e-15)


def test_a_state_in_the_ground_is_lifted_and_a_late_velocity_brought_forward(
    cube: ObjectModel, made: list[Toss]
) -> None:
    low = made[0].q[0].copy()
    low[2] = 0.0
    sunk = replace(made[0], q=np.vstack([low, made[0].q[1:]]))
    q, v = first_states([sunk], cube, Simulator(make_system(cube)), velocity_lag=0.01)
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
    shots = shots_of(cube, made, predictor := Simulator(make_system(cube, gravity=9.0)))
    assert len(shots.in_shares(3)) == 1
    assert [share.toss.tolist() for share in shots.in_shares(1)] == [[0], [2], [1, 3]]
    some, rest = shots.in_shares(2)
    assert (some.toss.tolist(), rest.toss.tolist()) == ([0, 2], [1, 3])
    errors = prediction_errors(predictor, some)
    np.testing.assert_array_equal(errors, prediction_errors(predictor, shots)[[0, 2], : errors.shape[1]])
