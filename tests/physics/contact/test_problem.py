"""Compliant contact and cohesion: what springs, dampers and sliding blocks are known to do."""

from __future__ import annotations

import numpy as np
import pytest

from tests.physics.worlds import energy
from tossid.objects import ObjectModel, corner_positions
from tossid.physics import ExactCone, PolyhedralCone, make_system, simulate
from tossid.physics.contact.law import ADHESION_REACH, BOUNCE_SPEED, RECOVERY_SPEED, Law
from tossid.physics.effects import World
from tossid.physics.effects.in_mujoco import toss_in_mujoco
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


def test_stiff_contact_tends_to_rigid(cube: ObjectModel) -> None:
    q, v = tossed(np.random.default_rng(1), 30)

    def final(compliance: float) -> np.ndarray:
        run = simulate(
            make_system(cube.with_changes(compliance=compliance)), q, v, n_steps=8, dt=1 / 148, tolerance=1e-11
        )
        assert (run.lam_n > 0).any(axis=(1, 2)).mean() > 0.8
        return run.v[:, -1]

    rigid = final(0.0)
    gaps = [np.median(np.abs(final(compliance) - rigid).max(axis=1)) for compliance in (1e-6, 1e-7, 1e-8)]
    assert gaps[2] < 1e-3
    assert 5 < gaps[0] / gaps[1] < 20
    assert 5 < gaps[1] / gaps[2] < 20


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


@both_cones
def test_cohesion_waits_for_load(cube: ObjectModel, solver: ContactSolver) -> None:
    q, v = tossed(np.random.default_rng(2), 30)
    q[:, 2] -= corner_positions(cube, q)[..., 2].min(-1) - 1e-3
    v[:, 2] -= 3
    runs = [
        simulate(make_system(cube.with_changes(cohesion=c)), q, v, n_steps=2, dt=1e-3, solver=solver)
        for c in (0.0, 0.5)
    ]
    struck = (runs[0].lam_n[:, 0] > 0).any(-1)
    assert struck.sum() > 15
    np.testing.assert_array_equal(runs[0].v[:, 1], runs[1].v[:, 1])
    assert (np.abs(runs[0].v[struck, 2] - runs[1].v[struck, 2]).max(-1) > 0).mean() > 0.5


@both_cones
def test_what_begins_in_rigid_ground_comes_out_slowly(cube: ObjectModel, solver: ContactSolver) -> None:
    """Recorded states lie in the ground by their noise; depth over a step would be a kick of 1 m/s."""
    system = make_system(cube)
    run = simulate(system, FLAT - [0, 0, 1e-3, 0, 0, 0, 0], np.zeros((1, 6)), n_steps=80, dt=1e-3,
                   tolerance=1e-11, solver=solver)  # fmt: skip
    assert np.abs(run.v[0, :, 2]).max() < 1.05 * RECOVERY_SPEED
    np.testing.assert_allclose(HALF - run.q[0, 10, 2], 1e-3 - 0.010 * RECOVERY_SPEED, atol=5e-5)
    np.testing.assert_allclose(run.q[0, 70:, 2], HALF, atol=1e-5)


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


def test_relaxed_friction_lifts_what_slides(cube: ObjectModel) -> None:
    """As MuJoCo has it: a slip at s leaves the ground at mu s; Coulomb's law keeps it there. Both slow down alike."""
    v0 = np.array([[1.0, 0, 0, 0, 0, 0]])
    speed, height = {}, {}
    for lifting in (0.0, 1e-4):
        world = World(cube, law=Law(lifting=lifting))
        run = simulate(world.system(), FLAT, v0, n_steps=30, dt=1 / 148, substeps=4)
        speed[lifting], height[lifting] = run.v[0, -1, 0], run.q[0, :, 2].max() - HALF
    q, v = toss_in_mujoco(World(cube), FLAT, v0, 30, 1 / 148, n_threads=1)
    theirs = q[0, :, 2].max() - HALF
    assert height[0.0] < 1e-6
    assert 0.5 < height[1e-4] / theirs < 1.5
    np.testing.assert_allclose(speed[1e-4], v[0, -1, 0], atol=0.04)
    np.testing.assert_allclose(speed[1e-4], speed[0.0], atol=0.05)


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
