"""Fields: each force against its potential or its work, in size, in sign and in the kernel."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from tossid.objects import ObjectModel
from tossid.physics import simulate
from tossid.physics.effects import BUILT_IN, World, effect_named
from tossid.physics.effects.wrenches import wrench_of_world

Array = NDArray[np.float64]

VALUES = {
    "uniform_force": [0.5, -0.3, 1.0],
    "position_force": [8.0, 0.3, -0.2, 0.6],
    "vortex": [3.0],
    "turning_frame": [2.0],
    "linear_drag": [0.3],
    "quadratic_drag": [0.2],
    "spin_drag": [4e-3],
    "magnus": [0.05],
}
"""Of the effects that are a force or a torque of the state."""


def wrench(world: World, p: Array, u: Array, omega: Array) -> tuple[Array, Array]:
    return wrench_of_world(world)(p, u, omega)


def motions(count: int = 20) -> tuple[Array, Array, Array]:
    """Positions, velocities and spins."""
    rng = np.random.default_rng(0)
    return rng.normal(size=(count, 3)), 2 * rng.normal(size=(count, 3)), 8 * rng.normal(size=(count, 3))


def test_all_effects_with_a_force_are_tested() -> None:
    assert {effect.name for effect in BUILT_IN if effect.family in ("field", "fluid")} == {*VALUES, "wind"}


@pytest.mark.parametrize("name", VALUES)
def test_a_force_is_in_proportion_to_its_parameter_and_none_at_zero(cube: ObjectModel, name: str) -> None:
    effect, values = effect_named(name), np.array(VALUES[name])
    for factor in (0.0, 0.5):
        less = values * (np.r_[factor, np.ones(3)] if name == "position_force" else factor)
        force, torque = wrench(effect.at(World(cube), less), *motions())
        whole = wrench(effect.at(World(cube), values), *motions())
        np.testing.assert_allclose(force, factor * whole[0], atol=1e-12)
        np.testing.assert_allclose(torque, factor * whole[1], atol=1e-12)


@pytest.mark.parametrize("name", VALUES)
def test_the_kernel_s_force_is_that_which_mujoco_is_given(cube: ObjectModel, name: str) -> None:
    """Of a single step so short that nothing else happens in it."""
    world = effect_named(name).at(World(cube, gravity=0.0), np.array(VALUES[name]))
    (p, u, omega), h = motions(), 1e-6
    p[:, 2] += 10.0
    q, v = np.concatenate([p, np.tile([1.0, 0, 0, 0], (len(p), 1))], axis=1), np.concatenate([u, omega], axis=1)
    without = simulate(World(cube, gravity=0.0).system(), q, v, n_steps=1, dt=h).v[:, 1]
    change = (simulate(world.system(), q, v, n_steps=1, dt=h).v[:, 1] - without) / h
    force, torque = wrench(world, p, u, omega)
    spun = np.linalg.solve(cube.inertia, torque[..., None])[..., 0]
    np.testing.assert_allclose(change[:, :3], force / cube.mass[0], atol=1e-4 * np.abs(force).max() + 1e-6)
    np.testing.assert_allclose(change[:, 3:], spun, atol=1e-4 * np.abs(spun).max() + 1e-6)


def test_a_spring_s_force_is_the_slope_of_its_energy(cube: ObjectModel) -> None:
    k, *center = VALUES["position_force"]
    world = effect_named("position_force").at(World(cube), np.array([k, *center]))
    p, u, omega = motions()
    energy = lambda p: 0.5 * k * ((p - center) ** 2).sum(axis=-1)  # noqa: E731
    step = 1e-5
    slope = np.stack([(energy(p + d) - energy(p - d)) / (2 * step) for d in step * np.eye(3)], axis=-1)
    np.testing.assert_allclose(wrench(world, p, u, omega)[0], -slope, atol=1e-6)


def test_a_vortex_pushes_around_the_vertical_and_a_turning_frame_does_no_work(cube: ObjectModel) -> None:
    p, u, omega = motions()
    vortex = wrench(effect_named("vortex").at(World(cube), np.array([3.0])), p, u, omega)[0]
    around = np.stack([-p[:, 1], p[:, 0], np.zeros(len(p))], axis=1)  # counter-clockwise, seen from above
    np.testing.assert_allclose(vortex, 3.0 * around)
    sideways = wrench(effect_named("turning_frame").at(World(cube), np.array([2.0])), p, u, omega)[0]
    np.testing.assert_allclose((sideways * u).sum(axis=1), 0.0, atol=1e-12)
    size = 2.0 * cube.mass[0] * np.hypot(u[:, 0], u[:, 1])
    np.testing.assert_allclose(np.linalg.norm(sideways, axis=1), size)
