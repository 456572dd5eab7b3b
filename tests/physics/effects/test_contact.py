"""Effects of contact, of the body and of the ground: what Coulomb and his successors predict by hand."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from tests.physics.worlds import DT, HALF, flat, run, slide
from tossid.objects import ObjectModel
from tossid.physics import simulate
from tossid.physics.effects import Forces, Law, World, effect_named, effects_for
from tossid.rotations import quat_exp, quat_rotate


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
