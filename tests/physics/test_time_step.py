"""The time step: rotations by series, momentum, and ground that is not passed."""

from __future__ import annotations

import numpy as np
import pytest

from tests.physics.solvers.contact_problems import landing
from tossid.kernels import kernel
from tossid.objects import ObjectModel, corner_positions
from tossid.physics import ExactCone, PolyhedralCone, make_system, simulate, time_step
from tossid.physics.effects import World
from tossid.physics.forces import Law
from tossid.physics.solvers import ContactSolver
from tossid.rotations import quat_exp, quat_mul, quat_to_matrix

DT = 1 / 148

both_cones = pytest.mark.parametrize("solver", [ExactCone(), PolyhedralCone(4)])


@kernel(keep=False)
def turned(q, x):  # type: ignore[no-untyped-def]
    return time_step.turned(q[0], q[1], q[2], q[3], x[0], x[1], x[2])


@kernel(keep=False)
def matrix(q, R):  # type: ignore[no-untyped-def]
    time_step.rotation(q, R)


def test_a_step_s_rotation_is_the_exponential() -> None:
    rng = np.random.default_rng(0)
    for size in (0.0, 1e-8, 1e-3, 0.1, 0.199, 0.201, 1.0, 3.0):
        q, x = rng.normal(size=4), rng.normal(size=3)
        q, x = q / np.linalg.norm(q), size * x / np.linalg.norm(x)
        np.testing.assert_allclose(turned(q, x), quat_mul(q, quat_exp(2 * x)), atol=2e-15)
        R = np.empty((3, 3))
        matrix(np.r_[np.zeros(3), q], R)
        np.testing.assert_allclose(R, quat_to_matrix(q), atol=1e-15)


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


def test_friction_makes_no_energy(cube: ObjectModel) -> None:
    q, v = landing(cube, np.random.default_rng(4), 60)
    run = simulate(make_system(cube), q, v, n_steps=80, dt=DT)
    spin = np.einsum("bti,ij,btj->bt", run.v[..., 3:], cube.inertia[0], run.v[..., 3:])
    energy = 0.5 * (spin + cube.mass[0] * (run.v[..., :3] ** 2).sum(-1)) + cube.mass[0] * 9.81 * run.q[..., 2]
    # a step that lifts the body out of the ground works against gravity: m g times the depth
    assert np.diff(energy, axis=1).max() < cube.mass[0] * 9.81 * 1e-3
    assert (energy[:, -1] < 0.7 * energy[:, 0]).all()


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
