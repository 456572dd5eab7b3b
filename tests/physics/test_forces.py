"""Forces of the state: in the time step as their equations of motion say, and as MuJoCo is given them."""

from __future__ import annotations

from functools import partial

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

from tests.physics.worlds import DT, run
from tossid.objects import ObjectModel
from tossid.physics import simulate
from tossid.physics.effects import Forces, World
from tossid.physics.effects.wrenches import acceleration_of_forces
from tossid.physics.forces import DRAG, MAGNUS, SPIN, SPRING, TURNING, VORTEX, wrench
from tossid.rotations import quat_rotate

Array = NDArray[np.float64]


FLIGHTS = {
    "linear": Forces(linear=0.3),
    "quadratic": Forces(quadratic=0.2),
    "spin": Forces(spin=0.004),
    "wind": Forces(linear=0.2, wind_x=4.0, wind_y=-2.0),
    "wind, quadratic": Forces(quadratic=0.1, wind_x=4.0, wind_y=-2.0),
    "magnus": Forces(magnus=0.05),
    "magnus in wind": Forces(magnus=0.05, wind_x=2.0, wind_y=1.0),
    "uniform": Forces(x=0.5, y=-0.3, z=1.0),
    "spring": Forces(spring=8.0, center_x=0.3, center_y=-0.2, center_z=3.0),
    "vortex": Forces(vortex=3.0),
    "turning": Forces(turning=3.0),
    "turning in wind": Forces(turning=2.0, linear=0.2, wind_x=3.0, wind_y=1.0),
    "all": Forces(0.1, 0.1, 0.002, 2.0, -1.0, 0.03, 0.3, -0.2, 0.5, 4.0, 0.3, 0.2, 1.0, 2.0, 1.5),
}


POWERED = {
    "drag": Forces(linear=0.05, wind_x=1.0, powered=DRAG, power=2.0),
    "spin": Forces(spin=4e-4, powered=SPIN, power=1.0),
    "magnus": Forces(magnus=0.05, powered=MAGNUS, power=-0.5),
    "spring": Forces(spring=8.0, center_z=1.0, powered=SPRING, power=-1.0),
    "vortex": Forces(vortex=3.0, powered=VORTEX, power=1.0),
    "turning": Forces(turning=1.0, powered=TURNING, power=1.0),
}


START = [0.2, -0.1, 3.0, 1.0, 0.0, 0.0, 0.0]


SPEED = [1.2, -0.8, 2.0, 6.0, -4.0, 8.0]


def derivative(forces: Forces, mass: float, inertia: Array, y: Array) -> Array:
    """dy/dt of y = (p, quaternion, u, omega in the body) for a body whose origin is its centre of mass."""
    f = forces
    p, quat, u, w = y[:3], y[3:7] / np.linalg.norm(y[3:7]), y[7:10], y[10:]
    omega = quat_rotate(quat, w)
    air = u - np.array([f.wind_x, f.wind_y, 0.0])
    to_center = np.array([f.center_x, f.center_y, f.center_z]) - p
    states = {DRAG: air, SPIN: w, MAGNUS: w, SPRING: to_center, VORTEX: p[:2], TURNING: u}
    grown = dict.fromkeys(states, 1.0)
    if f.powered in states:
        grown[int(f.powered)] = np.linalg.norm(states[int(f.powered)]) ** f.power
    force = (
        -(f.linear + f.quadratic * np.linalg.norm(air)) * grown[DRAG] * air
        + f.magnus * grown[MAGNUS] * np.cross(omega, air)
        + [f.x, f.y, f.z]
        + f.spring * grown[SPRING] * to_center
        + f.vortex * grown[VORTEX] * np.cross([0, 0, 1.0], p)
        + mass * f.turning * grown[TURNING] * np.cross([0, 0, 1.0], u)
    )
    a, b, c, d = quat
    x, y_, z = w
    rate = 0.5 * np.array(
        [-b * x - c * y_ - d * z, a * x + c * z - d * y_, a * y_ + d * x - b * z, a * z + b * y_ - c * x]
    )
    spin = np.linalg.solve(inertia, -f.spin * grown[SPIN] * w - np.cross(w, inertia @ w))
    return np.concatenate([u, rate, force / mass - [0, 0, 9.81], spin])


@pytest.mark.parametrize("size", [1.0, 30.0, 1e4])
def test_drag_stays_stable_however_large(cube: ObjectModel, size: float) -> None:
    world = World(cube, forces=Forces(linear=size, quadratic=size, spin=size))
    done = run(world, [0, 0, 5.0, 1, 0, 0, 0], [3, 0, 4, 20, -10, 5], seconds=2.0, substeps=1)
    assert done.finite[0]
    speed = np.linalg.norm(done.v[0, :, :3], axis=1)
    assert speed.max() <= speed[0] + 1e-9
    assert np.linalg.norm(done.v[0, :, 3:], axis=1).max() <= np.linalg.norm([20, -10, 5]) + 1e-9


@pytest.mark.parametrize("name", [*FLIGHTS, *POWERED])
def test_the_wrench_of_a_state_is_that_of_the_equations_of_motion(cube: ObjectModel, name: str) -> None:
    forces, mass, inertia, y = (FLIGHTS | POWERED)[name], float(cube.mass[0]), cube.inertia[0], np.array(START + SPEED)
    change = derivative(forces, mass, inertia, y) - derivative(Forces(), mass, inertia, y)
    force, torque = wrench(forces, mass, y[None, :3], y[None, 7:10], y[None, 10:])
    np.testing.assert_allclose(force[0], mass * change[7:10], atol=1e-12)
    np.testing.assert_allclose(torque[0], inertia @ change[10:], atol=1e-12)


def test_a_power_of_no_state_is_finite() -> None:
    still, forces = np.zeros((1, 3)), Forces(spring=1.0, powered=SPRING, power=-2.0)
    assert np.isfinite(wrench(forces, 1.0, still, still, still)[0]).all()


def after(forces: Forces, model: ObjectModel, start: Array, seconds: float) -> Array:
    """The exact state (13,), its origin the centre of mass."""
    right = partial(derivative, forces, float(model.mass[0]), model.inertia[0])
    run = solve_ivp(lambda t, y: right(y), (0.0, seconds), start, rtol=1e-11, atol=1e-12)
    return np.asarray(run.y[:, -1])


@pytest.mark.parametrize("name", FLIGHTS)
def test_flight_follows_the_equations_of_motion(cube: ObjectModel, name: str) -> None:
    forces, start = FLIGHTS[name], np.array(START + SPEED)
    exact, none = (after(each, cube, start, 0.5) for each in (forces, Forces()))
    errors = []
    for substeps in (1, 8):
        done = run(World(cube, forces=forces), START, SPEED, seconds=0.5, substeps=substeps, dt=0.01)
        state = np.concatenate([done.q[0, -1], done.v[0, -1]])
        state[3:7] *= np.sign(state[3:7] @ exact[3:7])
        errors.append(np.abs(state - exact).max())
    change = np.abs(exact - none).max()
    assert change > 0.01
    assert errors[1] < 1e-4 * change
    # second order: an eighth of the step, a sixty-fourth of the error (or rounding)
    assert errors[1] < max(errors[0] / 40, 1e-9)


def test_forces_act_at_the_centre_of_mass(cube: ObjectModel) -> None:
    """A body whose centre is off: the centre follows the equations, whatever the origin does."""
    forces = Forces(linear=0.1, magnus=0.02, x=0.5, spring=5.0, vortex=1.0)
    com, start = np.array([0.01, -0.02, 0.015]), np.array(START + SPEED)
    body = cube.with_changes(com=com[None])
    done = run(World(body, forces=forces), START, SPEED, seconds=0.4, substeps=200)
    start[:3] += com
    start[7:10] += np.cross(start[10:], com)
    centre = done.q[0, -1, :3] + quat_rotate(done.q[0, -1, 3:], com)
    np.testing.assert_allclose(centre, after(forces, body, start, round(0.4 / DT) * DT)[:3], atol=2e-5)


@pytest.mark.parametrize("forces", [FLIGHTS["all"], *POWERED.values()], ids=["all", *POWERED])
def test_a_step_s_accelerations_are_those_that_mujoco_is_given(cube: ObjectModel, forces: Forces) -> None:
    """Of a single step so short that nothing else happens in it."""
    rng, h = np.random.default_rng(0), 1e-6
    p, u, omega = rng.normal([0.0, 0.0, 10.0], size=(20, 3)), 2 * rng.normal(size=(20, 3)), 8 * rng.normal(size=(20, 3))
    q, v = np.concatenate([p, np.tile([1.0, 0, 0, 0], (20, 1))], axis=1), np.concatenate([u, omega], axis=1)
    world = World(cube, forces=forces)
    change = (simulate(world.system(), q, v, n_steps=1, dt=h).v[:, 1] - v) / h
    given = acceleration_of_forces(world, q, v)
    np.testing.assert_allclose(change, given, atol=1e-4 * np.abs(given).max() + 1e-6)
