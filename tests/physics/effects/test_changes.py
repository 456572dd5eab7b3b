"""Changes that several effects share set what they name, and nothing else."""

from __future__ import annotations

import numpy as np

from tossid.objects import ObjectModel
from tossid.physics.effects import Forces, Law, World
from tossid.physics.effects.changes import air_speed, power_factor, sets_forces, sets_law, with_object
from tossid.physics.forces import LEAST_STATE, PoweredForce


def test_a_change_sets_what_it_names_and_nothing_else(cube: ObjectModel) -> None:
    world = World(cube, forces=Forces(z=1.0), law=Law(rolling=0.1))
    changed = sets_forces(linear="c", x="f")(world, {"c": 0.2, "f": -0.3})
    assert changed == world.with_changes(forces=Forces(linear=0.2, x=-0.3, z=1.0))
    changed = sets_law(torsional="radius")(world, {"radius": 0.02})
    assert changed == world.with_changes(law=Law(torsional=0.02, rolling=0.1))
    other = with_object(world, friction=0.4)
    assert (other.object.friction, other.forces, cube.friction) == (0.4, world.forces, 0.18)


def test_velocity_in_the_air_is_that_less_the_wind() -> None:
    forces = Forces(wind_x=2.0, wind_y=-1.0)
    np.testing.assert_array_equal(air_speed(forces, np.array([2.0, -1.0, 0.5])), [0.0, 0.0, 0.5])


def test_one_force_has_a_further_power_of_its_state() -> None:
    forces, state = Forces(powered=float(PoweredForce.SPRING), power=2.0), np.array([[3.0, 4.0], [0.0, 0.0]])
    np.testing.assert_allclose(power_factor(forces, PoweredForce.SPRING, state), [[25.0], [LEAST_STATE**2]])
    np.testing.assert_array_equal(power_factor(forces, PoweredForce.DRAG, state), 1.0)
    assert np.isfinite(power_factor(forces._replace(power=-2.0), PoweredForce.SPRING, state)).all()
