"""Effects against theory: trajectories of the equations of motion, and what Coulomb would predict by hand."""

from __future__ import annotations

from functools import partial

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

from tossid.errors import InputError
from tossid.objects import OBJECT_FILES, ObjectModel, load_object
from tossid.physics import PolyhedralCone, Simulation, make_system, simulate
from tossid.physics.effects import LIBRARY, Forces, Law, RecordingErrors, World
from tossid.physics.forces import DRAG, MAGNUS, SPIN, SPRING, TURNING, VORTEX
from tossid.rotations import matrix_to_quat, quat_boxminus, quat_exp, quat_mul, quat_rotate, quat_to_matrix

Array = NDArray[np.float64]

DT = 1 / 148
HALF = 0.0524
EFFECTS = {effect.name: effect for effect in LIBRARY}


@pytest.fixture(scope="module")
def cube() -> ObjectModel:
    return load_object(OBJECT_FILES / "cube.xml")


def run(
    world: World, q: list[float], v: list[float], *, seconds: float, substeps: int = 4, dt: float = DT
) -> Simulation:
    system = world.system()
    return simulate(system, np.array([q]), np.array([v]), n_steps=round(seconds / dt), dt=dt, substeps=substeps)


def flat(height: float = HALF, *, x: float = 0.0) -> list[float]:
    """A cube that lies flat."""
    return [x, 0.0, height, 1.0, 0.0, 0.0, 0.0]


# ---------------------------------------------------------------- nothing at nominal values


@pytest.mark.parametrize("name", [effect.name for effect in LIBRARY if not effect.near_nothing])
def test_an_effect_at_its_nominal_values_changes_nothing(cube: ObjectModel, name: str) -> None:
    world = World(cube)
    effect = EFFECTS[name]
    same = effect.at(world, effect.nominal(world))
    rng = np.random.default_rng(0)
    q = np.concatenate([rng.uniform([-0.1, -0.1, 0.1], [0.1, 0.1, 0.2], (20, 3)), rng.normal(size=(20, 4))], axis=1)
    q[:, 3:] /= np.linalg.norm(q[:, 3:], axis=1, keepdims=True)
    v = rng.normal(size=(20, 6)) * [1, 1, 1, 5, 5, 5]
    nominal = world.roll_out(q, v, n_steps=60, dt=DT, substeps=2)
    np.testing.assert_array_equal(same.roll_out(q, v, n_steps=60, dt=DT, substeps=2), nominal)


def test_nominal_forces_and_law_are_nothing() -> None:
    assert not Forces(wind_x=3.0, center_z=1.0).acts
    assert not Law(slip_speed=0.3).acts
    assert all(Forces()._replace(**{name: 0.1}).acts for name in ("linear", "spin", "z", "spring", "turning"))
    assert all(Law()._replace(**{name: 0.1}).acts for name in ("static_rel", "y_rel", "torsional", "adhesion"))


def test_the_relaxed_law_and_the_polyhedral_cone_are_two_laws(cube: ObjectModel) -> None:
    q, v = np.array([[0, 0, 0.3, 1, 0, 0, 0]]), np.zeros((1, 6))
    simulate(World(cube, law=Law(rolling=0.1)).system(), q, v, n_steps=2, dt=DT, solver=PolyhedralCone(8))
    with pytest.raises(InputError, match="lifting"):
        simulate(World(cube, law=Law(lifting=1e-3)).system(), q, v, n_steps=2, dt=DT, solver=PolyhedralCone(8))


# ---------------------------------------------------------------- flight

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


@pytest.mark.parametrize("name", FLIGHTS)
def test_flight_follows_the_equations_of_motion(cube: ObjectModel, name: str) -> None:
    forces = FLIGHTS[name]
    exact = solve_ivp(
        lambda t, y: derivative(forces, float(cube.mass[0]), cube.inertia[0], y),
        (0.0, 0.5),
        START + SPEED,
        rtol=1e-11,
        atol=1e-12,
    ).y[:, -1]
    none = solve_ivp(
        lambda t, y: derivative(Forces(), float(cube.mass[0]), cube.inertia[0], y),
        (0.0, 0.5),
        START + SPEED,
        rtol=1e-11,
        atol=1e-12,
    ).y[:, -1]
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


@pytest.mark.parametrize("name", POWERED)
def test_a_force_may_grow_with_another_power(cube: ObjectModel, name: str) -> None:
    forces = POWERED[name]
    ends = []
    for each in (forces, forces._replace(power=0.0)):
        right = partial(derivative, each, float(cube.mass[0]), cube.inertia[0])
        ends.append(solve_ivp(lambda t, y, f=right: f(y), (0.0, 0.5), START + SPEED, rtol=1e-11, atol=1e-12).y[:, -1])
    done = run(World(cube, forces=forces), START, SPEED, seconds=0.5, substeps=8, dt=0.01)
    state = np.concatenate([done.q[0, -1], done.v[0, -1]])
    state[3:7] *= np.sign(state[3:7] @ ends[0][3:7])
    assert np.abs(ends[0] - ends[1]).max() > 0.01
    assert np.abs(state - ends[0]).max() < 1e-2 * np.abs(ends[0] - ends[1]).max()


def test_forces_act_at_the_centre_of_mass(cube: ObjectModel) -> None:
    """A body whose centre is off: the centre follows the equations, whatever the origin does."""
    forces = Forces(linear=0.1, magnus=0.02, x=0.5, spring=5.0, vortex=1.0)
    com = np.array([[0.01, -0.02, 0.015]])
    body = cube.with_changes(com=com)
    done = run(World(body, forces=forces), START, SPEED, seconds=0.4, substeps=200)
    seconds = round(0.4 / DT) * DT
    omega = np.array(SPEED[3:])
    begin = np.concatenate(
        [np.array(START[:3]) + com[0], START[3:], np.array(SPEED[:3]) + np.cross(omega, com[0]), omega]
    )
    exact = solve_ivp(
        lambda t, y: derivative(forces, float(body.mass[0]), body.inertia[0], y),
        (0.0, seconds),
        begin,
        rtol=1e-10,
        atol=1e-12,
    ).y[:, -1]
    centre = done.q[0, -1, :3] + quat_rotate(done.q[0, -1, 3:], com[0])
    np.testing.assert_allclose(centre, exact[:3], atol=2e-5)


@pytest.mark.parametrize("size", [1.0, 30.0, 1e4])
def test_drag_stays_stable_however_large(cube: ObjectModel, size: float) -> None:
    world = World(cube, forces=Forces(linear=size, quadratic=size, spin=size))
    done = run(world, [0, 0, 5.0, 1, 0, 0, 0], [3, 0, 4, 20, -10, 5], seconds=2.0, substeps=1)
    assert done.finite[0]
    speed = np.linalg.norm(done.v[0, :, :3], axis=1)
    assert speed.max() <= speed[0] + 1e-9
    assert np.linalg.norm(done.v[0, :, 3:], axis=1).max() <= np.linalg.norm([20, -10, 5]) + 1e-9


def test_a_spring_keeps_its_energy(cube: ObjectModel) -> None:
    """Without gravity, 100 swings in steps of 1/148 s."""
    k, m = 20.0, float(cube.mass[0])
    world = World(cube, gravity=0.0, forces=Forces(spring=k, center_z=5.0))
    done = run(world, [0.3, 0, 5.2, 1, 0, 0, 0], [0, 1.0, 0, 0, 0, 0], seconds=85.0, substeps=1)
    away = done.q[0, :, :3] - [0, 0, 5.0]
    energy = 0.5 * k * (away**2).sum(axis=1) + 0.5 * m * (done.v[0, :, :3] ** 2).sum(axis=1)
    assert np.ptp(energy) < 2e-3 * energy[0]


# ---------------------------------------------------------------- contact


def slide(world: World, *, speed: float, heading: float = 0.0, seconds: float = 0.3, substeps: int = 8) -> Array:
    """Velocity (T + 1, 2) of a cube that slides flat without turning: its inertia is made large."""
    heavy = world.object.with_changes(inertia=1e6 * world.object.inertia)
    v = [speed * np.cos(heading), speed * np.sin(heading), 0, 0, 0, 0]
    done = run(World(**{**world.__dict__, "object": heavy}), flat(), v, seconds=seconds, substeps=substeps)
    return done.v[0, :, :2]


def test_friction_follows_the_speed_of_sliding(cube: ObjectModel) -> None:
    world = EFFECTS["velocity_friction"].at(World(cube), np.array([0.5, 0.1, 0.3]))
    v = slide(world, speed=0.8, seconds=0.25)[:, 0]
    t = np.arange(len(v)) * DT
    mu = lambda s: 0.1 + 0.4 * np.exp(-((s / 0.3) ** 2))  # noqa: E731
    exact = solve_ivp(lambda t, s: -9.81 * mu(s), (0, t[-1]), [0.8], t_eval=t, rtol=1e-9).y[0]
    np.testing.assert_allclose(v, exact, atol=3e-3 * 0.8)


def test_friction_along_y_is_its_own(cube: ObjectModel) -> None:
    world = EFFECTS["anisotropic_friction"].at(World(cube), np.array([0.1, 0.3]))
    for heading in (0.0, 0.6, np.pi / 2, 2.5):
        v = slide(world, speed=1.0, heading=heading, seconds=0.2)
        speed = np.linalg.norm(v, axis=1)
        mu = 1 / np.hypot(np.cos(heading) / 0.1, np.sin(heading) / 0.3)
        np.testing.assert_allclose((speed[0] - speed[-1]) / (DT * (len(v) - 1)), mu * 9.81, rtol=2e-3)
        np.testing.assert_allclose(np.arctan2(v[-1, 1], v[-1, 0]), heading, atol=1e-6)


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


def test_an_edge_with_rounded_corners_stands_lower(cube: ObjectModel) -> None:
    """Balanced on an edge, the centre is at sqrt(2) (a - r) + r; on a face it is at a."""
    radius, turned = 0.006, np.array([np.cos(np.pi / 8), np.sin(np.pi / 8), 0.0, 0.0])
    height = np.sqrt(2) * (HALF - radius) + radius
    world = World(cube, law=Law(rounding=radius))
    on_edge = run(world, np.concatenate([[0, 0, height], turned]), [0.0] * 6, seconds=0.05)
    np.testing.assert_allclose(on_edge.q[0, :, 2], height, atol=1e-5)
    on_face = run(world, flat(), [0.0] * 6, seconds=0.05)
    np.testing.assert_allclose(on_face.q[0, :, 2], HALF, atol=1e-7)


def test_plain_systems_carry_no_forces(cube: ObjectModel) -> None:
    system = make_system(cube)
    assert system.forces.size == 0
    assert system.law.size == 0


# ---------------------------------------------------------------- ground and recording

STRANGE = World(
    object=load_object(OBJECT_FILES / "cube.xml"),
    ground_height=0.03,
    ground_tilt=(0.05, -0.08),
    recording=RecordingErrors(
        length_scale=1.1, clock_rate=0.9, frame_offset=(0.01, -0.02, 0.03), world_tilt=(-0.06, 0.1)
    ),
)


def states(count: int) -> tuple[Array, Array]:
    rng = np.random.default_rng(3)
    q = np.concatenate([rng.uniform(-0.2, 0.2, (count, 3)), rng.normal(size=(count, 4))], axis=1)
    q[:, 2] += 0.5
    q[:, 3:] /= np.linalg.norm(q[:, 3:], axis=1, keepdims=True)
    return q, rng.normal(size=(count, 6)) * [1, 1, 1, 5, 5, 5]


def test_states_come_back_from_the_ground_s_frame() -> None:
    q, v = states(50)
    back_q, back_v = STRANGE.recorded(*STRANGE.to_ground(q, v))
    np.testing.assert_allclose(back_q, q, atol=1e-12)
    np.testing.assert_allclose(back_v, v, atol=1e-12)


def test_recorded_velocities_are_the_rates_of_recorded_poses() -> None:
    """Of tosses in the ground's frame, at small steps."""
    q0, v0 = STRANGE.to_ground(*states(10))
    dt = 1e-5
    done = simulate(STRANGE.system(), q0, v0, n_steps=2, dt=dt)
    q, v = STRANGE.recorded(done.q, done.v)
    between = 2 * dt * STRANGE.recording.clock_rate
    np.testing.assert_allclose((q[:, 2, :3] - q[:, 0, :3]) / between, v[:, 1, :3], atol=1e-5)
    np.testing.assert_allclose(quat_boxminus(q[:, 2, 3:], q[:, 0, 3:]) / between, v[:, 1, 3:], atol=1e-5)


def by_hand(world: World, q: Array) -> Array:
    """Recorded poses of true ones, with matrices: p_rec = s W (p + R offset)."""
    r = world.recording
    W = quat_to_matrix(quat_exp(np.array([*r.world_tilt, 0.0])))
    R = quat_to_matrix(q[..., 3:])
    place = r.length_scale * (W @ (q[..., :3, None] + R @ np.array(r.frame_offset)[:, None]))[..., 0]
    return np.concatenate([place, matrix_to_quat(W @ R)], axis=-1)


@pytest.mark.parametrize(
    "recording",
    [
        RecordingErrors(length_scale=1.07),
        RecordingErrors(clock_rate=0.93),
        RecordingErrors(frame_offset=(0.01, -0.02, 0.015)),
        RecordingErrors(world_tilt=(0.08, -0.05)),
        STRANGE.recording,
    ],
)
def test_a_recording_is_the_true_motion_transformed(cube: ObjectModel, recording: RecordingErrors) -> None:
    q, v = states(8)
    world = World(cube, recording=recording)
    r = recording
    # true motion in true time, and its recording by hand
    true = simulate(World(cube).system(), q, v, n_steps=40, dt=DT / r.clock_rate, substeps=2)
    seen = by_hand(world, true.q)
    # the first recorded state: positions and turns as poses say, rates by differences of the recorded pose
    tiny = 1e-7
    ahead, behind = q.copy(), q.copy()
    for place, sign in ((ahead, 1), (behind, -1)):
        place[:, :3] += sign * tiny * v[:, :3]
        place[:, 3:] = quat_mul(q[:, 3:], quat_exp(sign * tiny * v[:, 3:]))
    rate = 0.5 / tiny / r.clock_rate
    first_v = np.concatenate(
        [
            (by_hand(world, ahead)[:, :3] - by_hand(world, behind)[:, :3]) * rate,
            quat_boxminus(by_hand(world, ahead)[:, 3:], by_hand(world, behind)[:, 3:]) * rate,
        ],
        axis=1,
    )
    exact_v = world.recorded(q, v)[1]
    np.testing.assert_allclose(first_v, exact_v, atol=1e-6)
    rolled = world.roll_out(seen[:, 0], exact_v, n_steps=40, dt=DT, substeps=2)
    np.testing.assert_allclose(rolled[..., :3], seen[..., :3], atol=1e-9)
    assert quat_boxminus(rolled[..., 3:], seen[..., 3:]) == pytest.approx(0, abs=1e-8)


def test_world_tilt_turns_true_coordinates_into_recorded_ones(cube: ObjectModel) -> None:
    """Turned by +a about x, the vertical leans to -y: a falling body drifts to +y in the recording."""
    world = World(cube, recording=RecordingErrors(world_tilt=(0.1, 0.0)))
    q = np.array([[0.0, 0, 5, 1, 0, 0, 0]])
    seen = world.roll_out(q, np.zeros((1, 6)), n_steps=30, dt=DT, substeps=1)[0, -1]
    way = 0.5 * 9.81 * (30 * DT) ** 2
    np.testing.assert_allclose(seen[:3] - q[0, :3], way * np.array([0, np.sin(0.1), -np.cos(0.1)]), atol=1e-9)


@pytest.mark.parametrize("height", [-0.02, 0.03])
def test_the_ground_lies_at_its_height(cube: ObjectModel, height: float) -> None:
    q = np.array([[0.0, 0, HALF + height + 0.05, 1, 0, 0, 0]])
    seen = World(cube, ground_height=height).roll_out(q, np.zeros((1, 6)), n_steps=100, dt=DT, substeps=2)
    np.testing.assert_allclose(seen[0, -1, 2], HALF + height, atol=1e-6)


def test_forces_stay_in_the_true_world_whatever_the_ground(cube: ObjectModel) -> None:
    """In flight the ground is nothing."""
    forces = Forces(x=0.5, y=-0.3, z=0.7, spring=6.0, center_x=0.2, center_y=-0.3, center_z=0.8, quadratic=0.1)
    q, v = np.array([[0.0, 0, 3, 1, 0, 0, 0]]), np.array([[1.0, 0.5, 1, 3, 0, -2]])
    ends = [
        World(cube, forces=forces, ground_tilt=tilt, ground_height=height).roll_out(
            q, v, n_steps=30, dt=DT, substeps=20
        )
        for tilt, height in (((0.0, 0.0), 0.0), ((0.1, -0.15), 0.04))
    ]
    np.testing.assert_allclose(ends[0], ends[1], atol=1e-9)
