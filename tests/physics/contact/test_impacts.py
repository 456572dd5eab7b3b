"""Impacts: where they happen, by the formulas of free fall, and in parts, by Routh's differential equation."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from tests.models.made import DT, thrown
from tests.physics.worlds import energy
from tossid.objects import ObjectModel, corner_positions
from tossid.physics import make_system, simulate
from tossid.physics.contact.law import IMPACT_SPEED, TOUCHING_HEIGHT
from tossid.physics.effects import World
from tossid.rotations import quat_exp, quat_to_matrix, skew

HALF, G = 0.0524, 9.81


@pytest.mark.parametrize("height", [0.03, 0.1, 0.27])
def test_a_flat_drop_rebounds_from_where_it_touches(cube: ObjectModel, height: float) -> None:
    """Newton's restitution at the time of impact, v' = e sqrt(2 g z), wherever steps begin.

    A corner strikes from `TOUCHING_HEIGHT`, 5e-5 m, above the ground: at 0.77 m/s and more, 6e-4 m/s or less too slow.
    """
    e = 0.5
    q = np.array([[0, 0, HALF + height, 1, 0, 0, 0.0]])
    system = make_system(cube.with_changes(restitution=e, friction=0.0))
    n = int(np.ceil(np.sqrt(2 * height / G) / DT)) + 2
    fall = SimpleNamespace(t=np.sqrt(2 * height / G), v=np.sqrt(2 * G * height))
    run = simulate(system, q, np.zeros((1, 6)), n_steps=n, dt=DT, impact_parts=8)
    after = n * DT - fall.t
    np.testing.assert_allclose(run.v[0, -1], [0, 0, e * fall.v - G * after, 0, 0, 0], atol=5e-4)
    np.testing.assert_allclose(run.q[0, -1, 2] - HALF, e * fall.v * after - 0.5 * G * after**2, atol=1e-4)
    assert run.lam_n.sum() == pytest.approx(cube.mass[0] * (1 + e) * fall.v, rel=1e-3)


def test_impacts_are_no_earlier_in_short_steps(cube: ObjectModel) -> None:
    """In steps of 26 µs a corner is within 50 µm of the ground for a step or two before it lands."""
    e, heights = 0.5, np.linspace(0.03, 0.05, 21)
    q = np.tile([0, 0, HALF, 1, 0, 0, 0.0], (21, 1))
    q[:, 2] += heights
    system = make_system(cube.with_changes(restitution=e, friction=0.0))
    run = simulate(system, q, np.zeros((21, 6)), n_steps=17, dt=DT, substeps=256, impact_parts=8)
    landing = np.sqrt(2 * G * heights)
    np.testing.assert_allclose(run.v[:, -1, 2], e * landing - G * (17 * DT - landing / G), atol=5e-5)


@pytest.mark.parametrize("height", [0.8 * TOUCHING_HEIGHT, 2.0 * TOUCHING_HEIGHT])
def test_what_nearly_touches_strikes_there(cube: ObjectModel, height: float) -> None:
    """At 0.3 m/s: at once, or where it has come as near to the ground."""
    speed = 0.3
    q, v0 = np.array([[0, 0, HALF + height, 1, 0, 0, 0.0]]), np.array([[0, 0, -speed, 0, 0, 0.0]])
    system = make_system(cube.with_changes(restitution=0.5, friction=0.0))
    way = height if height > TOUCHING_HEIGHT else 0.0
    landing = np.sqrt(speed**2 + 2 * G * way)
    run = simulate(system, q, v0, n_steps=1, dt=DT, impact_parts=8)
    assert run.v[0, -1, 2] == pytest.approx(0.5 * landing - G * (DT - (landing - speed) / G), abs=2e-5)


def test_what_comes_down_slowly_is_no_impact(cube: ObjectModel) -> None:
    """It is felt at the end of a step, and does not end it."""
    system, gap = make_system(cube.with_changes(friction=0.0), gravity=0.0), 2e-4
    for speed, ends in ((1.5 * IMPACT_SPEED, True), (0.5 * IMPACT_SPEED, False)):
        q, v0 = np.array([[0, 0, HALF + gap, 1, 0, 0, 0.0]]), np.array([[0, 0, -speed, 0, 0, 0.0]])
        run = simulate(system, q, v0, n_steps=1, dt=DT, impact_parts=8)
        assert (abs(run.v[0, -1, 2]) < 1e-9) == ends
        assert -gap / DT - 1e-6 < run.v[0, -1, 2] < 1e-9


# ---------------------------------------------------------------- in parts


LEAN = np.array([0.3, 0.5, 0.2])
"""A rotation vector after which one corner is lowest."""

SPEED = np.array([0.8, 0.3, -1.2, 2.0, -3.0, 4.0])


def in_parts(cube: ObjectModel, parts: int) -> World:
    world = World(cube)
    return replace(world, law=world.law._replace(impulse_parts=float(parts)))


def struck(cube: ObjectModel, parts: int) -> tuple[np.ndarray, np.ndarray]:
    """Velocity of the cube (6,) after its lowest corner strikes, and that corner's arm, world."""
    q = np.zeros((1, 7))
    q[0, 3:] = quat_exp(LEAN)
    arms = quat_to_matrix(q[0, 3:]) @ cube.corner_pos.T
    q[0, 2] = 1e-9 - arms[2].min()
    run = simulate(in_parts(cube, parts).system(), q, SPEED[None], n_steps=1, dt=1e-7, impact_parts=8)
    return run.v[0, -1], arms[:, arms[2].argmin()]


def routh(cube: ObjectModel, arm: np.ndarray) -> np.ndarray:
    """Velocity (6,) after the impact: d v = K (-mu s / |s|, 1) dp until the corner leaves at -e times its speed."""
    mass, inertia = float(cube.mass[0]), cube.inertia[0]
    turned = quat_to_matrix(quat_exp(LEAN))
    yields = turned @ np.linalg.inv(inertia) @ turned.T
    cross = skew(arm)
    K = np.eye(3) / mass - cross @ yields @ cross
    spin = turned @ SPEED[3:]
    first = SPEED[:3] + np.cross(spin, arm)

    def push(v: np.ndarray) -> np.ndarray:
        return np.array([*(-cube.friction * v[:2] / np.linalg.norm(v[:2])), 1.0])

    def left(_: float, state: np.ndarray) -> float:
        return float(state[2] + cube.restitution * first[2])

    left.terminal = True  # type: ignore[attr-defined]
    run = solve_ivp(
        lambda _, s: np.concatenate([K @ push(s[:3]), push(s[:3])]), (0, 10), np.concatenate([first, np.zeros(3)]),
        events=left, rtol=1e-10, atol=1e-12,
    )  # fmt: skip
    impulse = run.y[3:, -1]
    return np.concatenate([SPEED[:3] + impulse / mass, SPEED[3:] + turned.T @ (yields @ np.cross(arm, impulse))])


@pytest.mark.parametrize(("friction", "restitution"), [(0.18, 0.0), (0.18, 0.4), (0.3, 0.3)])
def test_many_parts_are_rouths_law(cube: ObjectModel, friction: float, restitution: float) -> None:
    body = cube.with_changes(friction=friction, restitution=restitution)
    off = {}
    for parts in (1, 8, 64):
        after, arm = struck(body, parts)
        off[parts] = float(np.abs(after - routh(body, arm))[:3].max())
    assert off[64] < 1e-3
    assert off[8] < 0.01
    # the slip turns by so much that one part is not the same impact
    assert off[1] > max(0.01, 4 * off[8])


@pytest.mark.parametrize("restitution", [0.0, 0.5])
def test_impacts_in_parts_keep_corners_up_and_give_no_energy(cube: ObjectModel, restitution: float) -> None:
    """Of many tosses with edges, faces and rocking: energy only falls, and corners stay out of the ground."""
    body = cube.with_changes(restitution=restitution)
    q, v = thrown(np.random.default_rng(5), 40)
    run = simulate(in_parts(body, 8).system(), q, v, n_steps=90, dt=DT, substeps=8, impact_parts=8)
    assert np.diff(energy(body, run.q, run.v), axis=1).max() < 2e-4
    assert corner_positions(body, run.q[:, 1:])[..., 2].min() > -2e-4
    assert run.unsolved.sum() < 5
