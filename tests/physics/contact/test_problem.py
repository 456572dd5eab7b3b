"""Compliant contact and cohesion: what springs, dampers and sliding blocks are known to do."""

from __future__ import annotations

import numpy as np
import pytest

from tests.physics.worlds import energy
from tossid.objects import ObjectModel
from tossid.physics import ExactCone, PolyhedralCone, make_system, simulate
from tossid.physics.contact.law import ADHESION_REACH, BOUNCE_SPEED, RECOVERY_SPEED, Law
from tossid.physics.effects import World
from tossid.physics.solvers import ContactSolver

HALF = 0.0524


STIFFNESS = 33e3


FLAT = np.array([[0, 0, HALF, 1, 0, 0, 0.0]])


both_cones = pytest.mark.parametrize("solver", [ExactCone(), PolyhedralCone(4)])


def tossed(rng: np.random.Generator, count: int) -> tuple[np.ndarray, np.ndarray]:
    """States just above the ground, turned and thrown anyhow."""
    q = np.concatenate([np.zeros((count, 2)), np.full((count, 1), 0.11), rng.normal(size=(count, 4))], 1)
    q[:, 3:] /= np.linalg.norm(q[:, 3:], axis=1, keepdims=True)
    return q, rng.normal(size=(count, 6)) * [1, 1, 0.3, 6, 6, 6] - [0, 0, 1, 0, 0, 0]


@both_cones
@pytest.mark.parametrize("relaxation", [0.0, 3e-3])
def test_a_cube_at_rest_sinks_by_its_weight(cube: ObjectModel, solver: ContactSolver, relaxation: float) -> None:
    system = make_system(cube.with_changes(compliance=1 / STIFFNESS, relaxation=relaxation))
    run = simulate(system, FLAT, np.zeros((1, 6)), n_steps=300, dt=1 / 148, tolerance=1e-12, solver=solver)
    assert HALF - run.q[0, -1, 2] == pytest.approx(cube.mass[0] * 9.81 / STIFFNESS / 4, rel=1e-6)
    np.testing.assert_allclose(np.sort(run.lam_n[0, -1])[4:], cube.mass[0] * 9.81 / 148 / 4, rtol=1e-6)


@both_cones
@pytest.mark.parametrize("relaxation", [2e-4, 1e-3, 2e-3])
def test_a_flat_drop_bounces_as_the_damped_oscillator(
    cube: ObjectModel, solver: ContactSolver, relaxation: float
) -> None:
    # Schwager and Poeschel, "Coefficient of restitution and linear-dashpot model revisited", Granular Matter 2007:
    # contact ends where the force would become a pull
    omega2 = 4 * STIFFNESS / cube.mass[0]
    beta = 0.5 * omega2 * relaxation
    omega = np.sqrt(omega2 - beta**2)
    duration = (np.pi - np.arctan2(2 * beta * omega, omega**2 - beta**2)) / omega
    system = make_system(cube.with_changes(compliance=1 / STIFFNESS, relaxation=relaxation), gravity=0.0)
    dt, v = 4e-5, np.array([[0, 0, -1.0, 0, 0, 0]])
    run = simulate(system, FLAT, v, n_steps=250, dt=dt, tolerance=1e-11, solver=solver)
    assert run.v[0, -1, 2] == pytest.approx(np.exp(-beta * duration), rel=0.01)
    assert dt * (run.lam_n[0].sum(-1) > 0).sum() == pytest.approx(duration, rel=0.02)
    np.testing.assert_allclose(run.v[0, -1, [0, 1, 3, 4, 5]], 0, atol=1e-9)


@pytest.mark.parametrize("dt", [1 / 148, 1e-4])
@pytest.mark.parametrize("relaxation", [0.0, 2e-3])
@pytest.mark.parametrize("cohesion", [0.0, 0.2])
def test_contact_makes_no_energy(cube: ObjectModel, dt: float, relaxation: float, cohesion: float) -> None:
    model = cube.with_changes(compliance=1 / STIFFNESS, relaxation=relaxation, cohesion=cohesion)
    q, v = tossed(np.random.default_rng(0), 30)
    run = simulate(make_system(model), q, v, n_steps=round(0.3 / dt), dt=dt)
    assert run.kkt_error.max() < 1e-4
    assert (run.lam_n > 0).any(axis=(1, 2)).all()
    total = energy(model, run.q, run.v)
    assert (total - np.minimum.accumulate(total, axis=1)).max() < 1e-9
    assert (total[:, -1] < 0.9 * total[:, 0]).all()


@both_cones
def test_rigid_corners_that_sank_come_out_at_their_own_pace(cube: ObjectModel, solver: ContactSolver) -> None:
    relaxation, depth, dt = 0.02, 1e-3, 0.002
    system = make_system(cube.with_changes(relaxation=relaxation))
    run = simulate(system, FLAT - [0, 0, depth, 0, 0, 0, 0], np.zeros((1, 6)), n_steps=30, dt=dt,
                   tolerance=1e-11, solver=solver)  # fmt: skip
    expected = depth * (relaxation / (relaxation + dt)) ** np.arange(31)
    np.testing.assert_allclose(HALF - run.q[0, :, 2], expected, rtol=1e-6)


# among four rigid corners the load is not unique, and Lemke's vertex leaves one without any, and without cohesion
@pytest.mark.parametrize(
    ("solver", "compliance"), [(ExactCone(), 0.0), (ExactCone(), 1 / STIFFNESS), (PolyhedralCone(4), 1 / STIFFNESS)]
)
@pytest.mark.parametrize(("cohesion", "slowing"), [(0.1, 0.3 * 9.81 + 4 * 0.1 / 0.37), (5.0, 2 * 0.3 * 9.81)])
def test_cohesion_slows_a_sliding_block_by_as_much_a_corner(
    cube: ObjectModel, solver: ContactSolver, compliance: float, cohesion: float, slowing: float
) -> None:
    model = cube.with_changes(friction=0.3, compliance=compliance, relaxation=1e-3, cohesion=cohesion)
    v = np.array([[0.8, 0, 0, 0, 0, 0]])
    start = FLAT - [0, 0, 0.37 * 9.81 / 4 * compliance, 0, 0, 0, 0]
    run = simulate(make_system(model), start, v, n_steps=200, dt=5e-4, solver=solver)
    assert run.unsolved.sum() == 0
    assert 0.8 - run.v[0, -1, 0] == pytest.approx(slowing * 0.1, rel=0.01)


def dropped(model: ObjectModel, height: float, speed: float, steps: int, law: Law = Law()) -> tuple[float, float]:
    """Height [m] and speed [m/s] of a flat cube after steps of 1 ms without gravity."""
    start, v0 = FLAT + np.array([0, 0, height, 0, 0, 0, 0]), np.array([[0, 0, speed, 0, 0, 0.0]])
    system = World(model, gravity=0.0, law=law).system()
    run = simulate(system, start, v0, n_steps=steps, dt=1e-3, tolerance=1e-11)
    return float(run.q[0, -1, 2]) - HALF, float(run.v[0, -1, 2])


def test_speeds_and_heights_decide_between_cases_of_contact(cube: ObjectModel) -> None:
    """Of restitution, of what begins in the ground, and of adhesion."""
    bouncy = cube.with_changes(restitution=0.5)
    for approach, speed in ((2 * BOUNCE_SPEED, BOUNCE_SPEED), (0.9 * BOUNCE_SPEED, 0.0)):
        _, found = dropped(bouncy, 1e-5, -approach, 3)
        assert found == pytest.approx(speed, abs=1e-6)
    height, _ = dropped(cube, -1e-3, 0.0, 10)
    assert height + 1e-3 == pytest.approx(0.010 * RECOVERY_SPEED, rel=0.11)  # the first step finds the depth
    for height, pulled in ((0.4 * ADHESION_REACH, True), (1.1 * ADHESION_REACH, False)):
        _, found = dropped(cube, height, 0.0, 1, Law(adhesion=0.8))
        assert (found < 0) == pulled


@pytest.mark.parametrize(("rise", "pushed"), [(0.05, True), (0.15, True), (0.21, False)])
def test_relaxed_friction_pushes_what_leaves_slower_than_mu_times_its_slip(
    cube: ObjectModel, rise: float, pushed: bool
) -> None:
    """At a slip of 1 m/s and friction of 0.18, up to 0.18 m/s; Coulomb's law pushes nothing that leaves."""
    soft = cube.with_changes(friction=0.18, compliance=1e-4, relaxation=0.02)
    sunk, v0 = FLAT - np.eye(7)[2] * 1e-6, np.array([[1.0, 0, rise, 0, 0, 0]])
    for lifting in (0.0, 1e-4):
        run = simulate(World(soft, law=Law(lifting=lifting)).system(), sunk, v0, n_steps=1, dt=1e-4)
        assert (run.lam_n.sum() > 0) == (pushed and lifting > 0)


def test_beyond_its_margin_a_corner_is_not_in_contact(cube: ObjectModel) -> None:
    """What comes down within a step is met by contact in that step, or falls through it and is met in the next."""
    soft, h = cube.with_changes(compliance=1e-4, relaxation=0.02), 1e-3
    q0, v0 = FLAT + np.eye(7)[2] * 2e-4, np.array([[0, 0, -1.0, 0, 0, 0]])
    for margin, first in ((np.inf, True), (3e-4, True), (0.0, False)):
        run = simulate(World(soft, law=Law(margin=margin)).system(), q0, v0, n_steps=2, dt=h)
        assert (run.lam_n[0, 0].sum() > 0) == first
        assert run.lam_n[0, 1].sum() > 0
        assert (run.v[0, 1, 2] == pytest.approx(-1.0 - 9.81 * h)) == (not first)
