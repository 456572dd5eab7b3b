"""The network: it rolls out what it predicts, learns a constant acceleration, and its divergence is reported."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from tests.models.made import DT, thrown, tosses
from tossid.models.e2e import EndToEnd
from tossid.models.transitions import make_transitions
from tossid.objects import ObjectModel


def test_a_network_without_output_keeps_its_velocity(cube: ObjectModel) -> None:
    network = EndToEnd(cube, hidden=4)
    with torch.no_grad():
        for parameter in network.parameters():
            parameter.zero_()
    q, v = thrown(np.random.default_rng(0), 3)
    run = network.simulator().rollout(q, v, n_steps=10, dt=DT)
    np.testing.assert_allclose(run.q[:, 10, :3], q[:, :3] + 10 * DT * v[:, :3])
    np.testing.assert_array_equal(run.v[:, 10], v)
    assert run.finite.all()


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
