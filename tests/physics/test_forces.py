"""Forces in the compiled time step: built-in and a user's, of one body and of links, by their equations of motion and
beside MuJoCo; joints that resist; and what pulls at an object in the air."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

from tests.models.made import thrown
from tests.physics.trees import EVERYTHING, flying, jointed, random_tree
from tests.physics.worlds import DT, run
from tossid.errors import InputError
from tossid.objects import ObjectModel
from tossid.physics import LearnedAcceleration, make_system, n_features, register_force, simulate
from tossid.physics.effects import Forces, World, effect_named
from tossid.physics.effects.in_mujoco import toss_in_mujoco
from tossid.physics.effects.wrenches import acceleration_of_forces, airborne, body_motions, learned_field
from tossid.physics.forces import DRAG, MAGNUS, SPIN, SPRING, TURNING, VORTEX, wrench
from tossid.physics.registered_forces import NoForce, combined, wrenches_of
from tossid.rotations import quat_conj, quat_mul, quat_rotate

Array = NDArray[np.float64]
Wrench = Callable[[Array, Array, Array], tuple[Array, Array]]
"""Force on the centre of mass and torque about it, of its place and velocity and of the spin, in the world's axes."""

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
    "all": EVERYTHING,
    "drag to a power": Forces(linear=0.05, wind_x=1.0, powered=DRAG, power=2.0),
    "spin to a power": Forces(spin=4e-4, powered=SPIN, power=1.0),
    "magnus to a power": Forces(magnus=0.05, powered=MAGNUS, power=-0.5),
    "spring to a power": Forces(spring=8.0, center_z=1.0, powered=SPRING, power=-1.0),
    "vortex to a power": Forces(vortex=3.0, powered=VORTEX, power=1.0),
    "turning to a power": Forces(turning=1.0, powered=TURNING, power=1.0),
}
START = [0.2, -0.1, 3.0, 1.0, 0.0, 0.0, 0.0]
SPEED = [1.2, -0.8, 2.0, 6.0, -4.0, 8.0]


@pytest.fixture(scope="module")
def body(cube: ObjectModel) -> ObjectModel:
    """A cube with its centre of mass off its origin."""
    return cube.with_changes(com=np.array([[0.01, -0.02, 0.015]]))


def at_centre(model: ObjectModel, q: Array, v: Array) -> Array:
    """State (13,) of the centre of mass: place, quaternion, velocity, spin in the body."""
    arm, spin = quat_rotate(q[3:7], model.com[0]), quat_rotate(q[3:7], v[3:6])
    return np.concatenate([q[:3] + arm, q[3:7] * np.sign(q[3]), v[:3] + np.cross(spin, arm), v[3:6]])


def exact(model: ObjectModel, wrench_of: Wrench, seconds: float) -> Array:
    """The same at the end of a flight, by the equations of Newton and Euler."""
    mass, inertia = float(model.mass[0]), model.inertia[0]

    def rate(_: float, y: Array) -> Array:
        p, quat, u, w = y[:3], y[3:7] / np.linalg.norm(y[3:7]), y[7:10], y[10:]
        force, torque = wrench_of(p, u, quat_rotate(quat, w))
        spin = np.linalg.solve(inertia, quat_rotate(quat_conj(quat), torque) - np.cross(w, inertia @ w))
        return np.concatenate([u, 0.5 * quat_mul(quat, np.append(0.0, w)), force / mass - [0, 0, 9.81], spin])

    begin = at_centre(model, np.array(START), np.array(SPEED))
    end = np.asarray(solve_ivp(rate, (0.0, seconds), begin, rtol=1e-11, atol=1e-12).y[:, -1])
    return np.concatenate([end[:3], end[3:7] * np.sign(end[3]), end[7:]])


def built_in(forces: Forces, model: ObjectModel) -> Wrench:
    return lambda p, u, spin: wrench(forces, float(model.mass[0]), p, u, spin)


@pytest.mark.parametrize("name", FLIGHTS)
def test_flight_follows_the_equations_of_motion(cube: ObjectModel, name: str) -> None:
    """The kernel's forces are those of `wrench`, which MuJoCo is given."""
    forces, errors = FLIGHTS[name], []
    truth, none = (exact(cube, built_in(each, cube), 0.5) for each in (forces, Forces()))
    for substeps in (1, 8):
        done = run(World(cube, forces=forces), START, SPEED, seconds=0.5, substeps=substeps, dt=0.01)
        errors.append(np.abs(at_centre(cube, done.q[0, -1], done.v[0, -1]) - truth).max())
    change = np.abs(truth - none).max()
    assert change > 0.01
    assert errors[1] < 6e-4 * change
    # second order: an eighth of the step, a sixty-fourth of the error (or rounding); first order in a state's power
    assert errors[1] < max(errors[0] / (6 if "power" in name else 40), 1e-9)


def test_forces_act_at_the_centre_of_mass(body: ObjectModel) -> None:
    """The centre follows the equations, whatever the origin does."""
    forces = Forces(linear=0.1, magnus=0.02, x=0.5, spring=5.0, vortex=1.0)
    done = run(World(body, forces=forces), START, SPEED, seconds=0.4, substeps=200)
    truth = exact(body, built_in(forces, body), round(0.4 / DT) * DT)
    np.testing.assert_allclose(at_centre(body, done.q[0, -1], done.v[0, -1])[:3], truth[:3], atol=2e-5)


def test_a_power_of_no_state_is_finite() -> None:
    still, forces = np.zeros((1, 3)), Forces(spring=1.0, powered=SPRING, power=-2.0)
    assert np.isfinite(wrench(forces, 1.0, still, still, still)[0]).all()


@pytest.mark.parametrize("size", [1.0, 30.0, 1e4])
def test_drag_stays_stable_however_large(cube: ObjectModel, size: float) -> None:
    world = World(cube, forces=Forces(linear=size, quadratic=size, spin=size))
    done = run(world, [0, 0, 5.0, 1, 0, 0, 0], [3, 0, 4, 20, -10, 5], seconds=2.0, substeps=1)
    assert done.finite[0]
    for part in (slice(0, 3), slice(3, 6)):
        speed = np.linalg.norm(done.v[0, :, part], axis=1)
        assert speed.max() <= speed[0] + 1e-9


# ---------------------------------------------------------------- a user's own


class Probe(NamedTuple):
    """A force and a torque that depend on all that a force may depend on."""

    pull_npm: float
    sideways_ns: float
    twist_ns: float


@register_force(Probe)
def probe(force, position, velocity, spin):  # type: ignore[no-untyped-def]
    pushed = (force.pull_npm * position[2], force.sideways_ns * spin[2], 0.0)
    return pushed, (0.0, 0.0, force.twist_ns * velocity[0])


class Lift(NamedTuple):
    force_n: float


@register_force(Lift)
def lift(force, position, velocity, spin):  # type: ignore[no-untyped-def]
    return (0.0, 0.0, force.force_n), (0.0, 0.0, 0.0)


STRONG, WEAK = Probe(0.8, 0.05, 4e-4), Probe(-0.3, 0.02, -1e-4)
FRAMES = 40


def flight_with(body: ObjectModel, f: Probe) -> Array:
    def wrench_of(p: Array, u: Array, spin: Array) -> tuple[Array, Array]:
        return np.array([f.pull_npm * p[2], f.sideways_ns * spin[2], 0.0]), np.array([0.0, 0.0, f.twist_ns * u[0]])

    return exact(body, wrench_of, FRAMES * DT)


def test_a_registered_force_moves_a_body_as_its_equations_say(body: ObjectModel) -> None:
    for force in (STRONG, WEAK):  # other values of the same type
        truth, without = flight_with(body, force), flight_with(body, Probe(0.0, 0.0, 0.0))
        errors, world = [], World(body).with_force(force)
        for substeps in (4, 8):
            done = run(world, START, SPEED, seconds=FRAMES * DT, substeps=substeps)
            errors.append(np.abs(at_centre(body, done.q[0, -1], done.v[0, -1]) - truth))
        assert (np.abs(truth - without)[[0, 1, 7, 8, 12]] > 0.003).all()
        assert (errors[1] < 2e-3 * (np.abs(truth - without).max() + 1e-6)).all()
        assert errors[1].max() < 0.6 * errors[0].max()  # a torque is taken at a step's start
    # and no toss depends on the others of its batch (here, as each process compiles the time step for the force anew)
    system = World(body).with_force(STRONG).system()
    q, v = np.stack([START, np.array(START) + 0.5]), np.stack([-2 * np.array(SPEED), SPEED])
    both, alone = (simulate(system, q[some], v[some], n_steps=FRAMES, dt=DT) for some in (slice(0, 2), slice(1, 2)))
    np.testing.assert_array_equal(both.v[1], alone.v[0])


@pytest.mark.slow
def test_links_share_a_force_by_mass(elbow: ObjectModel) -> None:
    """Both links' centres of mass are where the object's origin is, so that they feel what a single body does."""
    model, seconds = elbow.with_changes(com=np.zeros_like(elbow.com)), FRAMES * DT
    world = World(model).with_force(STRONG._replace(twist_ns=0.0))
    done = run(world, [*START, 0.0], [0.0] * 7, seconds=seconds, substeps=2)
    # m x'' = k z, z = 3 - g t² / 2
    sideways = STRONG.pull_npm / float(model.mass.sum()) * (3.0 * seconds**2 / 2 - 9.81 * seconds**4 / 24)
    assert done.q[0, -1, 0] - START[0] == pytest.approx(sideways, rel=5e-3)


def test_mujoco_gives_the_same_flight(body: ObjectModel) -> None:
    q, v = toss_in_mujoco(World(body).with_force(STRONG), np.array([START]), np.array([SPEED]), FRAMES, DT)
    truth = flight_with(body, STRONG)
    np.testing.assert_allclose(at_centre(body, q[0, -1], v[0, -1]), truth, atol=2e-3 * np.abs(truth).max())


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


@pytest.mark.parametrize(
    ("call", "says"),
    [
        (lambda cube: World(cube).with_force(Unknown(1.0)).system(), r"Unknown\(x=1.0\) is no registered force"),
        (lambda _: register_force(float)(lift), "expected a NamedTuple class"),
        (lambda _: register_force(Lift)(lift), "Lift has a force already"),
        (
            lambda _: register_force(Unknown)(lambda force, position: ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0))),
            r"takes \(force, position\), expected \(force, position, velocity, spin\)",
        ),
    ],
)
def test_what_is_no_registered_force_is_refused(cube: ObjectModel, call: Callable[..., object], says: str) -> None:
    with pytest.raises(InputError, match=says):
        call(cube)


# ---------------------------------------------------------------- links and joints


def common_velocity(model: ObjectModel, q: Array, v: Array) -> Array:
    return np.einsum("b,nbi->ni", model.mass / model.mass.sum(), body_motions(model, q, v)[1])


def test_links_accelerate_as_in_a_simulated_flight(elbow: ObjectModel) -> None:
    world, (q, v), dt = World(elbow, gravity=8.0, forces=EVERYTHING), thrown(np.random.default_rng(0), 5, 1), 1e-5
    q[:, 2] += 10.0
    after = simulate(world.system(), q, v, n_steps=1, dt=dt)
    expected = (common_velocity(elbow, after.q[:, 1], after.v[:, 1]) - common_velocity(elbow, q, v)) / dt
    np.testing.assert_allclose(acceleration_of_forces(world, q, v), expected, atol=1e-3)


@pytest.mark.parametrize(
    ("law", "forces"),
    [
        ({"damping": 1e-3}, Forces()),
        ({"stiffness": 0.05, "rest": 0.4}, Forces()),
        ({"armature": 2e-4}, Forces()),
        ({"friction": 4e-3}, Forces()),
        ({"damping": 5e-4, "stiffness": 0.02, "rest": -0.3, "armature": 1e-4, "friction": 1e-3}, EVERYTHING),
    ],
    ids=["damping", "stiffness", "armature", "friction", "all"],
)
def test_links_and_joints_in_flight_are_mujoco_s(elbow: ObjectModel, law: dict[str, float], forces: Forces) -> None:
    world, (q, v) = World(jointed(elbow, **law), forces=forces), flying(elbow)
    q[:, 2] -= 18.0
    v[:, 6] *= 2
    plain, ours = (
        simulate(each, q, v, n_steps=30, dt=DT, substeps=32).q for each in (make_system(elbow), world.system())
    )
    theirs, _ = toss_in_mujoco(world, q, v, 30, DT, substeps=68)
    assert np.abs(ours[..., 7] - plain[..., 7]).max() > 0.04  # it does something
    assert np.abs(ours[..., 7] - theirs[..., 7]).max() < 0.01
    assert np.abs(ours[..., :3] - theirs[..., :3]).max() < 2e-3


def test_a_joint_is_stable_however_much_it_resists(elbow: ObjectModel) -> None:
    for law in ({"damping": 100.0}, {"friction": 50.0}, {"damping": 1.0, "stiffness": 5.0}):
        done = simulate(make_system(jointed(elbow, **law)), *flying(elbow), n_steps=60, dt=DT)
        assert done.finite.all()
        assert np.abs(done.q[..., 7]).max() < 10.0


def test_joints_that_rub_enough_are_stiff(elbow: ObjectModel) -> None:
    """One exactly, and several together nearly."""
    tree = random_tree(np.random.default_rng(2), n_bodies=4)
    for model, friction, share in ((elbow, 1.0, 1e-12), (tree, 200.0, 0.05)):
        q, v = flying(model)
        v[:, 6:] = 0.0
        held, loose = (
            simulate(make_system(each), q, v, n_steps=5, dt=DT) for each in (jointed(model, friction=friction), model)
        )
        assert np.abs(held.v[..., 6:]).max() < share * np.abs(loose.v[..., 6:]).max()


# ---------------------------------------------------------------- what pulls in the air


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


def test_what_is_clear_of_the_ground_is_airborne(cube: ObjectModel) -> None:
    q = np.tile([0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0], (2, 1))
    q[:, 2] = 0.5 * cube.width + 0.1 * cube.width * np.array([0.99, 1.01])
    assert airborne(cube, q).tolist() == [False, True]
