"""What pulls at an object in the air is the motion of the simulator's flights, and of a learned acceleration's."""

from __future__ import annotations

import numpy as np

from tests.models.made import thrown
from tossid.objects import ObjectModel
from tossid.physics import LearnedAcceleration, n_features, simulate
from tossid.physics.effects import World, effect_named
from tossid.physics.effects.wrenches import acceleration_of_forces, airborne, body_motions, learned_field

FORCES = {
    "vortex": [3.0],
    "linear_drag": [0.3],
    "spin_drag": [3e-4],
    "position_force": [3.0, 0.1, -0.1, 0.2],
    "uniform_force": [0.8, -0.5, 0.1],
    "gravity": [8.0],
}


def common_velocity(model: ObjectModel, q: np.ndarray, v: np.ndarray) -> np.ndarray:
    return np.einsum("b,nbi->ni", model.mass / model.mass.sum(), body_motions(model, q, v)[1])


def test_a_learned_field_is_that_of_its_forces(cube: ObjectModel) -> None:
    off = cube.with_changes(com=np.array([[0.01, -0.02, 0.005]]))
    world = effect_named("vortex").at(World(off, gravity=0.0), np.array([2.0]))
    nf = n_features(0, world=True)
    linear = np.zeros((9, nf))
    linear[6, -5], linear[7, -6] = -2.0 / 0.37, 2.0 / 0.37
    k_res = LearnedAcceleration(linear, np.zeros((0, nf)), np.zeros(0), np.zeros((0, 0)), np.zeros(0), np.zeros((9, 0)))
    q, v = thrown(np.random.default_rng(1), 6)
    q[:, :2] = np.random.default_rng(2).normal(size=(6, 2))
    true, found = acceleration_of_forces(world, q, v), learned_field(off, k_res, q, v)
    assert not found[:, 3:].any()
    # the learned one is a field of the origin's place, the force one of the centre of mass's: 2 cm apart of a metre
    assert np.linalg.norm(found - true, axis=1).mean() < 0.2 * np.linalg.norm(true, axis=1).mean()
    centred = acceleration_of_forces(World(cube, gravity=0.0, forces=world.forces), q, v)
    np.testing.assert_allclose(learned_field(cube, k_res, q, v)[:, :3], centred[:, :3], atol=1e-9)
    assert not learned_field(off, None, q, v).any()


def test_links_accelerate_as_in_a_simulated_flight(elbow: ObjectModel) -> None:
    world = World(elbow)
    for name, values in FORCES.items():
        world = effect_named(name).at(world, np.array(values))
    q, v = thrown(np.random.default_rng(0), 5, 1)
    q[:, 2] += 10.0
    dt = 1e-5
    run = simulate(world.system(), q, v, n_steps=1, dt=dt)
    expected = (common_velocity(elbow, run.q[:, 1], run.v[:, 1]) - common_velocity(elbow, q, v)) / dt
    np.testing.assert_allclose(acceleration_of_forces(world, q, v), expected, atol=1e-3)


def test_what_is_clear_of_the_ground_is_airborne(cube: ObjectModel) -> None:
    q = np.tile([0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0], (2, 1))
    q[:, 2] = 0.5 * cube.width + 0.1 * cube.width * np.array([0.99, 1.01])
    assert airborne(cube, q).tolist() == [False, True]
