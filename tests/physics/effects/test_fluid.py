"""Air: drag takes energy, in the wind it pushes, and Magnus's force does no work."""

from __future__ import annotations

import numpy as np
import pytest

from tests.physics.effects.test_field import motions, wrench
from tossid.objects import ObjectModel
from tossid.physics.effects import World, effect_named
from tossid.physics.effects.fluid import LEAST_DRAG


@pytest.mark.parametrize(("name", "power", "size"), [("linear_drag", 1, 0.3), ("quadratic_drag", 2, 0.2)])
def test_drag_is_against_the_velocity_and_grows_with_its_power(
    cube: ObjectModel, name: str, power: int, size: float
) -> None:
    p, u, omega = motions()
    force, torque = wrench(effect_named(name).at(World(cube), np.array([size])), p, u, omega)
    speed = np.linalg.norm(u, axis=1)
    np.testing.assert_allclose((force * u).sum(axis=1), -size * speed ** (1 + power))  # the power that it takes
    np.testing.assert_allclose(np.cross(force, u), 0.0, atol=1e-12)
    assert not torque.any()


def test_spin_drag_takes_energy_from_spin_alone(cube: ObjectModel) -> None:
    p, u, omega = motions()
    force, torque = wrench(effect_named("spin_drag").at(World(cube), np.array([4e-3])), p, u, omega)
    np.testing.assert_allclose(torque, -4e-3 * omega)
    assert not force.any()


def test_wind_pushes_what_stands_still_and_leaves_what_moves_with_it(cube: ObjectModel) -> None:
    world = effect_named("wind").at(World(cube), np.array([3.0, -1.0, 0.2]))
    still, along = np.zeros((1, 3)), np.array([[3.0, -1.0, 0.0]])
    np.testing.assert_allclose(wrench(world, still, still, still)[0], 0.2 * along)
    np.testing.assert_allclose(wrench(world, still, along, still)[0], 0.0, atol=1e-15)
    assert effect_named("wind").nominal(World(cube)).tolist() == [0.0, 0.0, LEAST_DRAG]


def test_magnus_s_force_is_across_spin_and_velocity(cube: ObjectModel) -> None:
    world = effect_named("magnus").at(World(cube), np.array([0.05]))
    p, u, omega = motions()
    force, _ = wrench(world, p, u, omega)
    np.testing.assert_allclose((force * u).sum(axis=1), 0.0, atol=1e-12)
    np.testing.assert_allclose((force * omega).sum(axis=1), 0.0, atol=1e-12)
    # a ball with topspin about y that flies along x is pushed down
    down, _ = wrench(world, np.zeros(3), np.array([2.0, 0, 0]), np.array([0, 5.0, 0]))
    np.testing.assert_allclose(down, [0.0, 0.0, -0.5])
