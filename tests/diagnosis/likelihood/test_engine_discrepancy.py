"""Two engines agree in flight and differ in contact; a model moves by its own time step."""

from __future__ import annotations

import numpy as np
import pytest

from tests.diagnosis.tossed import seen
from tossid.diagnosis.likelihood.engine_discrepancy import Engine, MujocoWorld, comparable
from tossid.diagnosis.likelihood.windows import Windows, make_windows
from tossid.errors import InputError
from tossid.objects import ObjectModel
from tossid.physics.effects import Forces, World
from tossid.physics.effects.in_mujoco import scene


@pytest.fixture(scope="module")
def windows(cube: ObjectModel) -> Windows:
    return make_windows(seen(World(cube), cube, 4, seed=2), cube)


def test_mujoco_falls_as_a_parabola(cube: ObjectModel) -> None:
    world = World(cube)
    q0, v0 = np.array([[0.0, 0.0, 2.0, 1.0, 0.0, 0.0, 0.0]]), np.array([[1.0, 0.0, 0.0, 0.0, 0.0, 2.0]])
    run = MujocoWorld(scene(world, 1e-4), world).roll_out(q0, v0, n_steps=np.array([30]), dt=0.01)
    t = 0.01 * np.arange(31)
    np.testing.assert_allclose(run[0, :, 0], t, atol=1e-9)
    np.testing.assert_allclose(run[0, :, 2], 2.0 - 0.5 * world.gravity * t**2, atol=5e-4)
    np.testing.assert_allclose(2 * np.arctan2(run[0, :, 6], run[0, :, 3]), 2.0 * t, atol=1e-6)


def test_between_two_time_steps_a_body_goes_straight_on(cube: ObjectModel) -> None:
    world = World(cube)
    q0, v0 = np.array([[0.0, 0.0, 0.2, 1.0, 0.0, 0.0, 0.0]]), np.array([[1.0, 0.0, 0.0, 1.0, 0.5, 2.0]])
    m = scene(world, 1e-3)
    coarse = MujocoWorld(m, world).roll_out(q0, v0, n_steps=np.array([80]), dt=0.0025)[0]
    fine = MujocoWorld(m, world).roll_out(q0, v0, n_steps=np.array([200]), dt=0.001)[0]
    np.testing.assert_allclose(coarse[::2], fine[::5], atol=1e-12)
    np.testing.assert_allclose(coarse[1::2, :3], (fine[2::5, :3] + fine[3::5, :3]) / 2, atol=1e-9)
    assert m.opt.timestep == 1e-3


def test_a_model_of_another_state_is_refused(cube: ObjectModel, elbow: ObjectModel) -> None:
    other = MujocoWorld(scene(World(cube), 1e-3), World(elbow))
    with pytest.raises(InputError, match="more or other state"):
        other.roll_out(np.zeros((1, 8)), np.zeros((1, 7)), n_steps=np.array([2]), dt=0.01)


def test_engines_differ_in_contact_alone(cube: ObjectModel, windows: Windows) -> None:
    found = Engine().difference(windows, World(cube))
    assert found.expected == 0.0
    assert not found.values[windows.free | windows.steady].any()
    size = (np.abs(found.values) / windows.noise).max(axis=(1, 2))
    assert (size > 1).any()


def test_what_engines_compare_has_no_force_and_rigid_contact(cube: ObjectModel) -> None:
    world = World(cube.with_changes(compliance=1e-4, cohesion=0.1), forces=Forces(x=1.0))
    plain = comparable(world)
    assert (plain.object.compliance, plain.object.cohesion, plain.forces) == (0.0, 0.0, Forces())
    assert plain.object.friction == cube.friction
