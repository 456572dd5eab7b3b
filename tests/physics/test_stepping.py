"""Time stepping: conservation in flight and in contact, friction laws, orders of errors, rest, refusals."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from tests.physics.solvers.contact_problems import landing
from tests.physics.trees import random_state, random_tree
from tossid.errors import InputError, ObjectError
from tossid.objects import ObjectModel, corner_positions
from tossid.physics import ExactCone, PolyhedralCone, make_system, simulate, tree_batch
from tossid.physics.batch import mass_matrices
from tossid.physics.contact.law import Law
from tossid.physics.effects import World
from tossid.physics.solvers import ContactSolver
from tossid.rotations import quat_exp, quat_to_matrix

HALF, DT = 0.0524, 1 / 148


both_cones = pytest.mark.parametrize("solver", [ExactCone(), PolyhedralCone(4)])


def energy_of_tree(model: ObjectModel, q: np.ndarray, v: np.ndarray) -> float:
    system = make_system(model)
    batch = tree_batch(system, q[None], v[None])
    height = sum(model.mass[b] * (batch.x[0, b] + batch.R[0, b] @ model.com[b])[2] for b in range(model.n_bodies))
    return float(0.5 * v @ mass_matrices(batch, system)[0] @ v + 9.81 * height)


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_flight_keeps_energy_to_the_order_of_the_step(seed: int) -> None:
    rng = np.random.default_rng(seed)
    model = random_tree(rng, n_bodies=1 + seed, slides=False)
    q, v = random_state(rng, model)
    q[2] = 50.0
    errors = []
    for substeps in (4, 8, 16):
        run = simulate(make_system(model), q[None], v[None], n_steps=20, dt=0.005, substeps=substeps)
        errors.append(abs(energy_of_tree(model, run.q[0, -1], run.v[0, -1]) - energy_of_tree(model, q, v)))
    assert errors[0] > 1e-12
    assert errors[2] < 0.6 * errors[1] < 0.36 * errors[0] * 1.2


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


def test_threads_and_batches_change_nothing(cube: ObjectModel) -> None:
    rng = np.random.default_rng(1)
    q = np.tile([0, 0, 0.2, 1, 0, 0, 0.0], (6, 1))
    v = rng.normal(size=(6, 6))
    one = simulate(make_system(cube), q, v, n_steps=60, dt=1 / 148)
    two = simulate(make_system(cube), q, v, n_steps=60, dt=1 / 148, n_threads=2)
    np.testing.assert_array_equal(one.q, two.q)
    alone = simulate(make_system(cube), q[3:4], v[3:4], n_steps=60, dt=1 / 148)
    np.testing.assert_array_equal(alone.q[0], one.q[3])


@both_cones
def test_momentum_changes_by_gravity_and_the_impulses(cube: ObjectModel, solver: ContactSolver) -> None:
    q, v = landing(cube, np.random.default_rng(1), 30)
    run = simulate(make_system(cube), q, v, n_steps=40, dt=DT, solver=solver)
    mass, gained = cube.mass[0], np.diff(run.v[..., 2], axis=1)
    np.testing.assert_allclose(mass * (gained + 9.81 * DT), run.lam_n.sum(axis=2), atol=1e-12)
    # friction is at most mu times the normal impulses
    across = mass * np.linalg.norm(np.diff(run.v[..., :2], axis=1), axis=2)
    assert (across <= cube.friction * run.lam_n.sum(axis=2) * (1 + 1e-6) + 1e-6).all()


def test_without_friction_the_ground_pushes_upwards_only(cube: ObjectModel) -> None:
    """Horizontal momentum stays, and spin changes as the normal impulses' moments say."""
    q, v = landing(cube, np.random.default_rng(2), 30)
    run = simulate(make_system(cube, friction=0.0), q, v, n_steps=1, dt=DT, tolerance=1e-12)
    np.testing.assert_allclose(run.v[:, 1, :2], v[:, :2], atol=1e-12)
    R = quat_to_matrix(q[:, 3:])
    arms = corner_positions(cube, q) - q[:, None, :3]
    moment = np.einsum("bcx,bc->bx", np.cross(arms, [0.0, 0.0, 1.0]), run.lam_n[:, 0])
    gained = np.einsum("bij,jk,bk->bi", R, cube.inertia[0], run.v[:, 1, 3:] - v[:, 3:])
    assert np.abs(moment).max() > 1e-3
    # the gyroscopic change of spin is next to nothing: the cube's moments are equal
    np.testing.assert_allclose(gained, moment, atol=1e-9)


@both_cones
def test_the_ground_is_not_passed(cube: ObjectModel, solver: ContactSolver) -> None:
    """Depth is what a corner turns past the plane that the step saw, and does not grow."""
    q, v = landing(cube, np.random.default_rng(3), 30)
    depth = []
    for substeps in (2, 8):
        run = simulate(make_system(cube), q, v, n_steps=60, dt=DT, substeps=substeps, solver=solver)
        low = corner_positions(cube, run.q)[..., 2].min(axis=2)
        assert low[:, -1].min() > -1e-4
        depth.append(-low.min())
    assert depth[0] < 2e-3
    assert depth[1] < 0.5 * depth[0]


def test_errors_fall_with_the_square_of_the_step(cube: ObjectModel) -> None:
    """Of a body whose centre of mass is off its origin, in flight and as it turns on a corner without friction."""
    com = cube.com.copy()
    com[0] = 0.004, 0.002, -0.003
    spin = np.array([2.0, -1.0, 6.0])
    on_corner, aloft = np.zeros((1, 7)), np.zeros((1, 7))
    on_corner[:, 3:] = aloft[:, 3:] = quat_exp(np.array([0.55, 0.6, 0.1]))
    corners = corner_positions(cube, on_corner)[0]
    on_corner[:, 2], aloft[:, 2] = -corners[:, 2].min(), 2.0
    arm = corners[corners[:, 2].argmin()]
    v = np.array([[*-np.cross(quat_to_matrix(on_corner[0, 3:]) @ spin, arm), *spin]])
    for model, q in ((cube.with_changes(com=com), aloft), (cube, on_corner)):
        runs = [
            simulate(
                make_system(model, friction=0.0), q, v, n_steps=6, dt=DT, substeps=n, impact_parts=8, tolerance=1e-10
            )
            for n in (2, 8, 512)
        ]
        coarse, fine = (np.abs(run.q - runs[-1].q).max() for run in runs[:2])
        assert (runs[-1].lam_n.sum(axis=2) > 0).all() == (q is on_corner)
        assert 1e-9 < fine < coarse / 10


def test_resistance_to_rolling_hardly_hangs_on_the_step(cube: ObjectModel) -> None:
    """It is by the step's own load, also in the step after an impact, which nothing loaded before."""
    system = World(cube, law=Law(rolling=0.03)).system()
    q = np.array([[0, 0, 0.1, *quat_exp(np.array([0.3, 0.2, 0.0]))]])
    v = np.array([[0.2, 0.0, -0.5, 0.0, 3.0, 0.0]])
    coarse, fine = (
        simulate(system, q, v, n_steps=14, dt=DT, substeps=n, impact_parts=8, tolerance=1e-9) for n in (2, 128)
    )
    landed = int((fine.lam_n[0].sum(axis=1) > 0).argmax())
    assert landed < 11
    np.testing.assert_allclose(coarse.q[0, landed + 3, :3], fine.q[0, landed + 3, :3], atol=1e-5)


def test_cohesion_acts_from_the_landing_on_whatever_the_step(cube: ObjectModel) -> None:
    """A cube lands flat at 1 m/s across: by the load of the step before, it slid on for a step without cohesion."""
    sticky = World(cube.with_changes(cohesion=0.3))
    q = np.array([[0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0]])
    q[0, 2] = 5e-4 - corner_positions(cube, q)[..., 2].min()
    v = np.array([[1.0, 0.0, 0.0, 0.0, 0.0, 0.0]])
    coarse, fine = (
        sticky.roll_out(q, v, n_steps=12, dt=DT, substeps=substeps, impact_parts=2)[0, -1, 0] for substeps in (2, 64)
    )
    assert abs(coarse - fine) < 5e-4
    plain = World(cube).roll_out(q, v, n_steps=12, dt=DT, substeps=64, impact_parts=2)[0, -1, 0]
    assert plain - fine > 3e-3


@pytest.mark.parametrize(
    ("call", "says"),
    [
        (lambda cube: simulate(make_system(cube), np.zeros((1, 8)), np.zeros((1, 6)), n_steps=1, dt=0.01), "initial"),
        (lambda cube: make_system(cube, gravity=float("nan")), "gravity is"),
        (lambda cube: make_system(cube, friction=-0.1), r"friction is -0\.1"),
        (lambda cube: make_system(cube.with_changes(restitution=0.2, compliance=1e-3)), "restitution 0.2.*compliance"),
        (lambda cube: make_system(cube.with_changes(restitution=0.2, relaxation=1e-3)), "restitution 0.2.*relaxation"),
    ],
)
def test_what_cannot_be_simulated_is_refused(
    cube: ObjectModel, call: Callable[[ObjectModel], object], says: str
) -> None:
    with pytest.raises((InputError, ObjectError), match=says):
        call(cube)
