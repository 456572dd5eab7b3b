"""The simulator with a model's numbers: its rollouts, and its acceleration without contact."""

from __future__ import annotations

import numpy as np

from tests.models.made import DT, thrown
from tossid.models.predictor import Simulator
from tossid.objects import ObjectModel
from tossid.physics import make_system, simulate


def test_rollouts_take_the_simulators_substeps_and_impacts_where_they_happen(cube: ObjectModel) -> None:
    system = make_system(cube)
    q, v = thrown(np.random.default_rng(0), 3)
    found = Simulator(system, substeps=4).rollout(q, v, n_steps=60, dt=DT)
    np.testing.assert_array_equal(found.q, simulate(system, q, v, n_steps=60, dt=DT, substeps=4, impact_parts=8).q)
    assert np.abs(found.q - Simulator(system, substeps=1).rollout(q, v, n_steps=60, dt=DT).q).max() > 1e-6


def test_impacts_that_last_happen_where_steps_end(cube: ObjectModel) -> None:
    system = make_system(cube.with_changes(compliance=1e-4, relaxation=1e-3))
    q, v = thrown(np.random.default_rng(0), 3)
    found = Simulator(system, substeps=4).rollout(q, v, n_steps=60, dt=DT)
    np.testing.assert_array_equal(found.q, simulate(system, q, v, n_steps=60, dt=DT, substeps=4).q)


def test_acceleration_is_gravity_and_eulers_equations(cube: ObjectModel) -> None:
    inertia = np.diag([1e-3, 2e-3, 2.5e-3])[None]
    simulator = Simulator(make_system(cube.with_changes(inertia=inertia, com=np.zeros((1, 3))), gravity=9.0))
    q, v = thrown(np.random.default_rng(1), 5)
    found = simulator.acceleration(q, v)
    np.testing.assert_allclose(found[:, :3], np.tile([0, 0, -9.0], (5, 1)), atol=1e-12)
    spin = v[:, 3:]
    expected = -np.cross(spin, spin @ inertia[0]) / np.diag(inertia[0])
    np.testing.assert_allclose(found[:, 3:], expected, atol=1e-9)
