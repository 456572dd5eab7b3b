"""Time stepping: conservation in flight, friction laws, rest."""

from __future__ import annotations

import numpy as np
import pytest

from tests.physics.trees import random_state, random_tree
from tossid.errors import InputError
from tossid.objects import OBJECT_FILES, ObjectModel, corner_positions, load_object
from tossid.physics import ExactCone, PolyhedralCone, make_system, no_learned_acceleration, simulate, tree
from tossid.physics.solvers import ContactSolver
from tossid.rotations import quat_exp

CUBE = OBJECT_FILES / "cube.xml"
HALF = 0.0524


@pytest.fixture(scope="module")
def cube() -> ObjectModel:
    return load_object(CUBE)


def energy(model: ObjectModel, q: np.ndarray, v: np.ndarray) -> float:
    system = make_system(model)
    work = tree.make_work(system)
    tree.kinematics(system, q, work)
    tree.mass_matrix(system, work)
    height = sum(model.mass[b] * (work.xpos[b] + work.xmat[b] @ model.com[b])[2] for b in range(model.n_bodies))
    return float(0.5 * v @ work.M @ v + 9.81 * height)


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_flight_keeps_energy_to_the_order_of_the_step(seed: int) -> None:
    rng = np.random.default_rng(seed)
    model = random_tree(rng, n_bodies=1 + seed, slides=False)
    q, v = random_state(rng, model)
    q[2] = 50.0
    errors = []
    for substeps in (4, 8, 16):
        run = simulate(make_system(model), q[None], v[None], n_steps=20, dt=0.005, substeps=substeps)
        errors.append(abs(energy(model, run.q[0, -1], run.v[0, -1]) - energy(model, q, v)))
    assert errors[0] > 1e-12
    assert errors[2] < 0.6 * errors[1] < 0.36 * errors[0] * 1.2


def test_flight_is_ballistic_and_keeps_angular_momentum(cube: ObjectModel) -> None:
    q, v = np.array([0, 0, 2.0, 1, 0, 0, 0]), np.array([1.0, -0.5, 2.0, 3.0, 4.0, 5.0])
    run = simulate(make_system(cube), q[None], v[None], n_steps=40, dt=0.01)
    np.testing.assert_allclose(run.q[0, -1, 2], 2.0 + 2.0 * 0.4 - 0.5 * 9.81 * 0.16, atol=1e-12)
    np.testing.assert_allclose(run.v[0, -1, 3:], v[3:], atol=1e-12)


@pytest.mark.parametrize("solver", [ExactCone(), PolyhedralCone(4)])
def test_learned_linear_features_are_quadratic_drag(cube: ObjectModel, solver: ContactSolver) -> None:
    drag, speed, time = 0.3, np.array([1.5, -2.0, 4.0]), 0.5
    linear = np.zeros((6, 9))
    linear[:3, 3:6] = -drag * np.eye(3)
    system = make_system(
        cube, gravity=0.0, k_res=no_learned_acceleration(0)._replace(linear=linear, W2=np.zeros((6, 0)))
    )
    q, v = np.array([[0, 0, 2.0, *quat_exp([0.3, 0.4, 0.5])]]), np.array([[*speed, 0, 0, 0]])
    run = simulate(system, q, v, n_steps=100, dt=time / 100, substeps=20, solver=solver)
    expected = speed / (1 + drag * np.linalg.norm(speed) * time)  # of dv/dt = -drag |v| v
    np.testing.assert_allclose(run.v[0, -1, :3], expected, rtol=1e-3)


@pytest.mark.parametrize("solver", [ExactCone(), PolyhedralCone(4)])
def test_a_sliding_block_stops_where_coulomb_says(cube: ObjectModel, solver: ContactSolver) -> None:
    speed, mu = 0.8, 0.3
    run = simulate(
        make_system(cube, friction=mu),
        np.array([[0, 0, HALF, 1, 0, 0, 0.0]]),
        np.array([[speed, 0, 0, 0, 0, 0.0]]),
        n_steps=500,
        dt=0.001,
        solver=solver,
    )
    assert run.unsolved.sum() == 0
    assert run.q[0, -1, 0] == pytest.approx(speed**2 / (2 * mu * 9.81), rel=0.01)
    assert np.abs(run.v[0, -1]).max() < 1e-6


@pytest.mark.parametrize(("tilt", "slides"), [(0.25, False), (0.35, True)])
def test_a_tilted_block_slides_when_the_tilt_exceeds_friction(cube: ObjectModel, tilt: float, slides: bool) -> None:
    g = 9.81 * np.array([np.sin(tilt), 0.0, -np.cos(tilt)])
    mu = np.tan(0.3)
    q, v = np.array([[0, 0, HALF, 1, 0, 0, 0.0]]), np.zeros((1, 6))
    run = simulate(make_system(cube, gravity=g, friction=mu), q, v, n_steps=200, dt=0.002)
    expected = 0.5 * 9.81 * (np.sin(tilt) - mu * np.cos(tilt)) * 0.4**2 if slides else 0.0
    assert run.q[0, -1, 0] == pytest.approx(expected, rel=0.02, abs=1e-6)


def test_tosses_end_at_rest_above_the_ground(cube: ObjectModel) -> None:
    rng = np.random.default_rng(0)
    count = 40
    q = np.concatenate(
        [rng.normal(size=(count, 2)), rng.uniform(0.15, 0.4, (count, 1)), rng.normal(size=(count, 4))], 1
    )
    q[:, 3:] /= np.linalg.norm(q[:, 3:], axis=1, keepdims=True)
    v = np.concatenate([rng.normal(size=(count, 3)), rng.normal(size=(count, 3)) * 5], axis=1)
    run = simulate(make_system(cube), q, v, n_steps=300, dt=1 / 148, substeps=4)
    assert run.finite.all()
    assert run.unsolved.sum() <= 0.001 * count * 1200
    assert np.abs(run.v[:, -1]).max() < 1e-3
    assert corner_positions(cube, run.q)[..., 2].min() > -2e-3
    np.testing.assert_allclose(np.sort(corner_positions(cube, run.q[:, -1])[..., 2], axis=1)[:, :4], 0, atol=1e-4)


def test_restitution_returns_a_share_of_the_speed(cube: ObjectModel) -> None:
    bouncy = make_system(cube.with_changes(restitution=0.5))
    q = np.array([[0, 0, 0.3, *quat_exp([0, 0, 0.2])]])
    run = simulate(bouncy, q, np.zeros((1, 6)), n_steps=300, dt=0.001)
    k = int(np.argmax(run.v[0, :, 2] > 0))
    assert run.v[0, k, 2] == pytest.approx(-0.5 * run.v[0, k - 1, 2], rel=0.03)


def test_threads_and_batches_change_nothing(cube: ObjectModel) -> None:
    rng = np.random.default_rng(1)
    q = np.tile([0, 0, 0.2, 1, 0, 0, 0.0], (6, 1))
    v = rng.normal(size=(6, 6))
    one = simulate(make_system(cube), q, v, n_steps=60, dt=1 / 148)
    two = simulate(make_system(cube), q, v, n_steps=60, dt=1 / 148, n_threads=2)
    np.testing.assert_array_equal(one.q, two.q)
    alone = simulate(make_system(cube), q[3:4], v[3:4], n_steps=60, dt=1 / 148)
    np.testing.assert_array_equal(alone.q[0], one.q[3])


def test_bad_shapes_are_refused(cube: ObjectModel) -> None:
    with pytest.raises(InputError, match="initial states"):
        simulate(make_system(cube), np.zeros((1, 8)), np.zeros((1, 6)), n_steps=1, dt=0.01)
    with pytest.raises(InputError, match="n_directions"):
        simulate(make_system(cube), np.zeros((1, 7)), np.zeros((1, 6)), n_steps=1, dt=0.01, solver=PolyhedralCone(3))
