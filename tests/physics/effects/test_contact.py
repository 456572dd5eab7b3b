"""Effects of contact: what Coulomb and his successors predict by hand."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

from tests.physics.worlds import DT, HALF, flat, run, slide
from tossid.errors import InputError
from tossid.objects import ObjectModel
from tossid.physics import PolyhedralCone, simulate
from tossid.physics.effects import Forces, Law, World, effect_named
from tossid.rotations import quat_exp, quat_rotate

Array = NDArray[np.float64]


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


def test_the_relaxed_law_and_the_polyhedral_cone_are_two_laws(cube: ObjectModel) -> None:
    q, v = np.array([[0, 0, 0.3, 1, 0, 0, 0]]), np.zeros((1, 6))
    simulate(World(cube, law=Law(rolling=0.1)).system(), q, v, n_steps=2, dt=DT, solver=PolyhedralCone(8))
    with pytest.raises(InputError, match="lifting"):
        simulate(World(cube, law=Law(lifting=1e-3)).system(), q, v, n_steps=2, dt=DT, solver=PolyhedralCone(8))
