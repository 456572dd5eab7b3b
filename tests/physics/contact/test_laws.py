"""Laws of contact, and the body and the ground: what springs, dampers, Coulomb and his successors predict by hand."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from tests.models.made import thrown
from tests.physics.worlds import DT, HALF, energy, flat, run, slide
from tossid.objects import ObjectModel
from tossid.physics import ExactCone, PolyhedralCone, make_system, simulate
from tossid.physics.contact.law import ADHESION_REACH, BOUNCE_SPEED, RECOVERY_SPEED
from tossid.physics.effects import Forces, Law, World, effect_named, effects_for
from tossid.physics.solvers import ContactSolver
from tossid.rotations import quat_exp, quat_rotate

STIFFNESS = 33e3

FLAT = np.array([[0, 0, HALF, 1, 0, 0, 0.0]])

both_cones = pytest.mark.parametrize("solver", [ExactCone(), PolyhedralCone(4)])


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
    q, v = thrown(np.random.default_rng(0), 30)
    q[:, 2], v[:, 2] = 0.11, 0.3 * v[:, 2] - 1.0  # they land soon
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


# ---------------------------------------------------------------- friction, adhesion, and the body and the ground


def test_friction_follows_the_speed_of_sliding(cube: ObjectModel) -> None:
    world = effect_named("velocity_friction").at(World(cube), np.array([0.5, 0.1, 0.3]))
    v = slide(world, speed=0.8, seconds=0.25)[:, 0]
    t = np.arange(len(v)) * DT
    mu = lambda s: 0.1 + 0.4 * np.exp(-((s / 0.3) ** 2))  # noqa: E731
    exact = solve_ivp(lambda t, s: -9.81 * mu(s), (0, t[-1]), [0.8], t_eval=t, rtol=1e-9).y[0]
    np.testing.assert_allclose(v, exact, atol=3e-3 * 0.8)


def test_friction_along_y_is_its_own(cube: ObjectModel) -> None:
    world = effect_named("anisotropic_friction").at(World(cube), np.array([0.1, 0.3]))
    for heading in (0.0, 0.6, np.pi / 2, 2.5):
        v = slide(world, speed=1.0, heading=heading, seconds=0.2)
        speed = np.linalg.norm(v, axis=1)
        mu = 1 / np.hypot(np.cos(heading) / 0.1, np.sin(heading) / 0.3)
        np.testing.assert_allclose((speed[0] - speed[-1]) / (DT * (len(v) - 1)), mu * 9.81, rtol=2e-3)
        np.testing.assert_allclose(np.arctan2(v[-1, 1], v[-1, 0]), heading, atol=1e-6)


def test_torsional_friction_stops_a_spin_in_time(cube: ObjectModel) -> None:
    """Without Coulomb's friction: I w / (r m g)."""
    world = World(cube.with_changes(friction=0.0), law=Law(torsional=0.01))
    spin = 8.0
    predicted = float(cube.inertia[0, 2, 2]) * spin / (0.01 * float(cube.mass[0]) * 9.81)
    done = run(world, flat(), [0, 0, 0, 0, 0, spin], seconds=2 * predicted)
    still = np.flatnonzero(np.abs(done.v[0, :, 5]) < 1e-9)
    assert abs(still[0] * DT - predicted) < 0.05 * predicted
    assert np.abs(done.v[0, still[0] :, 5]).max() < 1e-9


def test_torsional_friction_resists_spin_at_an_impact(cube: ObjectModel) -> None:
    """A cube that lands flat takes up m v of impulse at once, and loses radius m v of its spin's momentum."""
    radius, fall, spin = 0.004, 1.2, 20.0
    world = World(cube.with_changes(friction=0.0), gravity=0.0, law=Law(torsional=radius))
    q, v = np.array([[0, 0, 0.06, 1.0, 0, 0, 0]]), np.array([[0, 0, -fall, 0, 0, spin]])
    run = simulate(world.system(), q, v, n_steps=3, dt=DT, substeps=4, impact_parts=8)
    lost = radius * cube.mass[0] * fall / cube.inertia[0, 2, 2]
    np.testing.assert_allclose(run.v[0, -1], [0, 0, 0, 0, 0, spin - lost], atol=2e-3)


def test_rolling_resistance_takes_the_tumble_s_energy(cube: ObjectModel) -> None:
    """A cube that tips over an edge loses r N for each radian, and one without resistance next to nothing."""
    lean = 0.5
    turn = quat_exp(np.array([0.0, lean, 0.0]))
    low = -quat_rotate(turn, np.array([HALF, 0.0, -HALF]))
    q = [0.0, 0.0, float(low[2]), *turn]
    pivot = np.array([low[0], 0.0, low[2]])  # from the edge to the centre
    speed = 2.0
    v = [*np.cross([0, speed, 0], pivot), 0.0, speed, 0.0]
    ends = []
    for radius in (0.0, 0.004):
        world = World(cube.with_changes(friction=1.0), law=Law(rolling=radius))
        done = run(world, q, v, seconds=0.04, substeps=40)
        m, inertia = float(cube.mass[0]), float(cube.inertia[0, 1, 1])
        energy = (
            m * 9.81 * done.q[0, :, 2]
            + 0.5 * m * (done.v[0, :, :3] ** 2).sum(axis=1)
            + 0.5 * inertia * done.v[0, :, 4] ** 2
        )
        load = done.lam_n[0].sum(axis=1) / DT
        turned = np.abs(done.v[0, :-1, 4] + done.v[0, 1:, 4]) / 2 * DT
        ends.append((energy[-1] - energy[1], (load * turned)[1:].sum()))
    (free, _), (lost, work) = ends
    assert abs(free) < 2e-5
    np.testing.assert_allclose(lost - free, -0.004 * work, rtol=0.05)


@pytest.mark.parametrize(("lift", "held"), [(0.9, True), (1.1, False)])
def test_adhesion_holds_until_four_corners_give_in(cube: ObjectModel, lift: float, held: bool) -> None:
    """Each of four corners holds 0.5 N; the lift is a share of that, above the weight."""
    force = 0.5
    weight = float(cube.mass[0]) * 9.81
    world = World(cube, forces=Forces(z=weight + lift * 4 * force), law=Law(adhesion=force))
    done = run(world, flat(), [0.0] * 6, seconds=0.5)
    rise = done.q[0, -1, 2] - HALF
    assert (abs(rise) < 1e-7) if held else (rise > 0.02)


def test_adhesion_adds_to_friction(cube: ObjectModel) -> None:
    """mu (m g + 4 A), of a cube pulled sideways."""
    weight, force = float(cube.mass[0]) * 9.81, 1.0
    bound = cube.friction * (weight + 4 * force)
    for share, moves in ((0.97, False), (1.03, True)):
        world = World(cube, forces=Forces(x=share * bound), law=Law(adhesion=force))
        done = run(world, flat(), [0.0] * 6, seconds=0.5)
        way = 0.5 * 0.03 * bound / float(cube.mass[0]) * 0.5**2
        assert (done.q[0, -1, 0] > 0.5 * way) == moves


# ---------------------------------------------------------------- the body and the ground


def test_a_cube_whose_corners_are_one_ball_rolls_as_a_ball(cube: ObjectModel) -> None:
    """Down a slope b without slipping: a = g sin(b) / (1 + I / (m r²))."""
    slope, m, inertia = 0.05, float(cube.mass[0]), float(cube.inertia[0, 1, 1])
    ball = cube.with_changes(corner_pos=HALF * np.sign(cube.corner_pos), friction=1.0)
    world = World(ball, ground_tilt=(0.0, slope), law=Law(rounding=HALF))
    done = run(world, flat(), [0.0] * 6, seconds=44 * DT)
    expected = 9.81 * np.sin(slope) / (1 + inertia / (m * HALF**2))
    assert done.v[0, -1, 0] / (44 * DT) == pytest.approx(expected, rel=1e-3)
    assert done.v[0, -1, 4] * HALF == pytest.approx(done.v[0, -1, 0], rel=1e-6)
    np.testing.assert_allclose(done.q[0, :, 2], HALF, atol=1e-6)


def test_the_inertia_of_links_may_be_of_another_shape(cube: ObjectModel, elbow: ObjectModel) -> None:
    of_links, of_a_body = ({e.name: e for e in effects_for(model)}["inertia"] for model in (elbow, cube))
    world = World(elbow)
    same = of_links.at(world, of_links.nominal(world))
    np.testing.assert_allclose(same.object.inertia, elbow.inertia, rtol=1e-12)
    larger = of_links.at(world, np.array([1.3, 1.0, 1.0])).object.inertia
    np.testing.assert_allclose(larger, of_a_body.at(world, np.array([1.3])).object.inertia, rtol=1e-12)

    # a solid box of 1, 2, 3 becomes one of 1, 4, 1.5
    box = 0.1 * np.array([1.0, 4.0, 9.0]) / 12
    moments = np.diag(box.sum() - box)
    boxes = World(elbow.with_changes(inertia=np.tile(moments, (2, 1, 1))))
    found = of_links.at(boxes, np.array([1.0, 4.0, 0.25])).object.inertia
    other = 0.1 * np.array([1.0, 16.0, 2.25]) / 12
    np.testing.assert_allclose(found, np.tile(np.diag(other.sum() - other), (2, 1, 1)), atol=1e-15)
    for least in ([5.0, 0.05, 0.05], [0.2, 10.0, 0.05], [1.0, 10.0, 10.0]):
        a, b, c = np.linalg.eigvalsh(of_links.at(world, np.array(least)).object.inertia[1])
        assert 0 < a <= b <= c < a + b


@pytest.mark.parametrize(("angle", "moves"), [(0.165, False), (0.195, True)])
@pytest.mark.parametrize("axis", [0, 1])
def test_a_block_slides_on_a_slope_steeper_than_its_friction(
    cube: ObjectModel, angle: float, moves: bool, axis: int
) -> None:
    """mu = 0.18. The cube is put flat on the tilted ground, and seen in the true, level world."""
    tilt = (angle, 0.0) if axis == 0 else (0.0, angle)
    turn = quat_exp(np.array([*tilt, 0.0]))
    q = np.concatenate([quat_rotate(turn, np.array([0, 0, HALF])), turn])
    world = World(cube, ground_tilt=tilt)
    seen = world.roll_out(q[None], np.zeros((1, 6)), n_steps=60, dt=DT, substeps=2)[0]
    moved = seen[-1, :3] - seen[0, :3]
    if not moves:
        assert np.abs(moved).max() < 1e-6
        return
    # it goes down, in the direction of the slope: a turn about +x lowers -y, about +y lowers +x
    way = 0.5 * 9.81 * (np.sin(angle) - 0.18 * np.cos(angle)) * (60 * DT) ** 2
    down = np.array([0, -np.cos(angle), -np.sin(angle)] if axis == 0 else [np.cos(angle), 0, -np.sin(angle)])
    np.testing.assert_allclose(moved, way * down, atol=0.03 * way)


@pytest.mark.parametrize("height", [-0.02, 0.03])
def test_the_ground_lies_at_its_height(cube: ObjectModel, height: float) -> None:
    q = np.array([[0.0, 0, HALF + height + 0.05, 1, 0, 0, 0]])
    seen = World(cube, ground_height=height).roll_out(q, np.zeros((1, 6)), n_steps=100, dt=DT, substeps=2)
    np.testing.assert_allclose(seen[0, -1, 2], HALF + height, atol=1e-6)
