"""Impacts in parts: Routh's law of a lone corner, by its differential equation, and no energy from nothing."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from tests.models.made import DT, thrown
from tests.physics.worlds import energy
from tossid.objects import ObjectModel, corner_positions
from tossid.physics import simulate
from tossid.physics.effects import World
from tossid.rotations import quat_exp, quat_to_matrix, skew

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


def test_one_part_is_the_impact_at_once(cube: ObjectModel) -> None:
    q, v = thrown(np.random.default_rng(3), 8)
    how = {"n_steps": 40, "dt": DT, "substeps": 4, "impact_parts": 8}
    np.testing.assert_array_equal(in_parts(cube, 1).roll_out(q, v, **how), World(cube).roll_out(q, v, **how))


@pytest.mark.parametrize("restitution", [0.0, 0.5])
def test_impacts_in_parts_keep_corners_up_and_give_no_energy(cube: ObjectModel, restitution: float) -> None:
    """Of many tosses with edges, faces and rocking: energy only falls, and corners stay out of the ground."""
    body = cube.with_changes(restitution=restitution)
    q, v = thrown(np.random.default_rng(5), 40)
    run = simulate(in_parts(body, 8).system(), q, v, n_steps=90, dt=DT, substeps=8, impact_parts=8)
    assert np.diff(energy(body, run.q, run.v), axis=1).max() < 2e-4
    assert corner_positions(body, run.q[:, 1:])[..., 2].min() > -2e-4
    assert run.unsolved.sum() < 5
