"""What predicts: the simulator with a model's numbers, and the network, whose divergence is reported."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from tests.models.made import DT, thrown, tosses
from tossid.models.e2e import EndToEnd
from tossid.models.predictor import Simulator
from tossid.models.transitions import make_transitions
from tossid.objects import ObjectModel
from tossid.physics import make_system, simulate


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
