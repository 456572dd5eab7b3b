"""A user's force in the compiled time step, against its equations of motion and against MuJoCo."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from tossid.errors import InputError
from tossid.objects import ObjectModel
from tossid.physics import register_force, simulate
from tossid.physics.effects import World
from tossid.physics.effects.in_mujoco import toss_in_mujoco
from tossid.physics.registered_forces import NoForce, combined, wrenches_of
from tossid.rotations import quat_rotate

DT, FRAMES = 1 / 148, 40
TIME = FRAMES * DT
COM = np.array([0.01, -0.02, 0.015])
START = np.array([0.2, -0.1, 3.0, 1.0, 0.0, 0.0, 0.0])
SPEED = np.array([1.2, -0.8, 2.0, 3.0, -2.0, 4.0])


class Probe(NamedTuple):
    """A force and a torque that depend on all that a force may depend on."""

    pull_npm: float
    sideways_ns: float
    twist_ns: float


@register_force(Probe)
def probe(force, position, velocity, spin):  # type: ignore[no-untyped-def]
    pushed = (force.pull_npm * position[2], force.sideways_ns * spin[2], 0.0)
    return pushed, (0.0, 0.0, force.twist_ns * velocity[0])


STRONG, WEAK = Probe(0.8, 0.05, 4e-4), Probe(-0.3, 0.02, -1e-4)


def plain(cube: ObjectModel) -> ObjectModel:
    """A cube that turns as a ball, with its centre of mass off its origin."""
    return cube.with_changes(com=COM[None], inertia=np.eye(3)[None] * cube.inertia[0, 0, 0])


def exact(cube: ObjectModel, force: Probe) -> np.ndarray:
    """Position and velocity of the centre of mass and spin in the world (9,), by the equations of motion."""
    mass, moment = float(cube.mass[0]), float(cube.inertia[0, 0, 0])

    def derivative(t: float, y: np.ndarray) -> np.ndarray:
        push = np.array([force.pull_npm * y[2], force.sideways_ns * y[8], 0.0])
        return np.concatenate([y[3:6], push / mass - [0, 0, 9.81], [0.0, 0.0, force.twist_ns * y[3] / moment]])

    begin = np.concatenate([START[:3] + COM, SPEED[:3] + np.cross(SPEED[3:], COM), SPEED[3:]])
    return np.asarray(solve_ivp(derivative, (0.0, TIME), begin, rtol=1e-10, atol=1e-12).y[:, -1])


def at_centre(q: np.ndarray, v: np.ndarray) -> np.ndarray:
    """The same of simulated states."""
    arm, spin = quat_rotate(q[3:7], COM), quat_rotate(q[3:7], v[3:6])
    return np.concatenate([q[:3] + arm, v[:3] + np.cross(spin, arm), spin])


def test_a_registered_force_moves_a_body_as_its_equations_say(cube: ObjectModel) -> None:
    body = plain(cube)
    for force in (STRONG, WEAK):  # other values of the same type
        truth, without = exact(body, force), exact(body, Probe(0.0, 0.0, 0.0))
        errors = []
        for substeps in (4, 8):
            run = simulate(
                World(body).with_force(force).system(),
                START[None],
                SPEED[None],
                n_steps=FRAMES,
                dt=DT,
                substeps=substeps,
            )
            errors.append(np.abs(at_centre(run.q[0, -1], run.v[0, -1]) - truth))
        assert (np.abs(truth - without)[[0, 1, 3, 4, 8]] > 0.003).all()
        assert (errors[1] < 2e-3 * (np.abs(truth - without).max() + 1e-6)).all()
        assert errors[1].max() < 0.6 * errors[0].max()  # a torque is taken at a step's start
    # and no toss depends on the others of its batch (here, as each process compiles the time step for the force anew)
    system = World(body).with_force(STRONG).system()
    q, v = np.stack([START, START + 0.5]), np.stack([-2 * SPEED, SPEED])
    both, alone = (simulate(system, q[some], v[some], n_steps=FRAMES, dt=DT) for some in (slice(0, 2), slice(1, 2)))
    np.testing.assert_array_equal(both.v[1], alone.v[0])


@pytest.mark.slow
def test_links_share_a_force_by_mass(elbow: ObjectModel) -> None:
    """Both links' centres of mass are where the object's origin is, so that they feel what a single body does."""
    model = elbow.with_changes(com=np.zeros_like(elbow.com))
    q, v = np.concatenate([START, [0.0]]), np.zeros(7)
    run = simulate(
        World(model).with_force(STRONG._replace(twist_ns=0.0)).system(),
        q[None],
        v[None],
        n_steps=FRAMES,
        dt=DT,
        substeps=2,
    )
    # m x'' = k z, z = 3 - g t² / 2
    sideways = STRONG.pull_npm / float(model.mass.sum()) * (3.0 * TIME**2 / 2 - 9.81 * TIME**4 / 24)
    assert run.q[0, -1, 0] - START[0] == pytest.approx(sideways, rel=5e-3)


def test_mujoco_gives_the_same_flight(cube: ObjectModel) -> None:
    body = plain(cube)
    q, v = toss_in_mujoco(World(body).with_force(STRONG), START[None], SPEED[None], FRAMES, DT)
    truth = exact(body, STRONG)
    np.testing.assert_allclose(at_centre(q[0, -1], v[0, -1]), truth, atol=2e-3 * np.abs(truth).max())


class Lift(NamedTuple):
    force_n: float


@register_force(Lift)
def lift(force, position, velocity, spin):  # type: ignore[no-untyped-def]
    return (0.0, 0.0, force.force_n), (0.0, 0.0, 0.0)


def test_several_forces_add_up() -> None:
    rng = np.random.default_rng(0)
    states = rng.normal(size=(3, 5, 3))
    one, other = wrenches_of(STRONG, *states), wrenches_of(Lift(2.0), *states)
    for together in ((STRONG, Lift(2.0)), (Lift(1.5), STRONG, Lift(0.5))):
        force, torque = wrenches_of(combined(together), *states)
        np.testing.assert_allclose(force, one[0] + other[0])
        np.testing.assert_allclose(torque, one[1] + other[1])
    assert combined(()) == NoForce()
    np.testing.assert_array_equal(wrenches_of(NoForce(), *states), 0.0)


class Unknown(NamedTuple):
    x: float


def test_what_is_no_registered_force_is_refused(cube: ObjectModel) -> None:
    with pytest.raises(InputError, match=r"Unknown\(x=1.0\) is no registered force"):
        World(cube).with_force(Unknown(1.0)).system()
    with pytest.raises(InputError, match="expected a NamedTuple class"):
        register_force(float)(lift)
    with pytest.raises(InputError, match="Lift has a force already"):
        register_force(Lift)(lift)
    with pytest.raises(InputError, match=r"takes \(force, position\), expected \(force, position, velocity, spin\)"):
        register_force(Unknown)(lambda force, position: ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0)))
