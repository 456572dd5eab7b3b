"""Strengths reach their targets, and motions are known ones."""

from __future__ import annotations

import numpy as np
import pytest

from tests.audit.throws import DT, cube_world, throws
from tossid.audit.displacement import displacement_between, motion, strength_reaching
from tossid.audit.strengths import world_with
from tossid.objects import ObjectModel
from tossid.physics.effects import JOINT_EFFECTS, World


@pytest.mark.parametrize("name", ["gravity", "com_offset", "friction", "time_base", "cubic_drag", "telegraph_force"])
def test_strengths_move_the_object_as_far_as_asked(name: str) -> None:
    world = cube_world()
    values, reached = strength_reaching(name, 30.0, world, *throws(10), noise=1.5e-4, n_steps=100, dt=DT, seed=7)
    assert 20 < reached < 45
    again = strength_reaching(name, 30.0, world, *throws(10), noise=1.5e-4, n_steps=100, dt=DT, seed=7)
    assert again == (values, reached)


@pytest.mark.parametrize("name", sorted(effect.name for effect in JOINT_EFFECTS))
def test_strengths_of_joints_move_the_links_as_far_as_asked(elbow: ObjectModel, name: str) -> None:
    q0, v0 = throws(10)
    q0, v0 = np.column_stack([q0, np.linspace(-2, 2, 10)]), np.column_stack([v0, np.linspace(6, -6, 10)])
    q0[:, 2] += 1.0
    _, reached = strength_reaching(name, 30.0, World(elbow), q0, v0, noise=1.5e-4, n_steps=60, dt=DT, seed=7)
    assert 20 < reached < 45


def test_the_way_is_that_of_a_known_fall() -> None:
    """Without contact, gravity less by 1 m/s² moves the object by t² / 2."""
    world = cube_world()
    q0, v0 = throws(5)
    q0[:, 2] += 50
    one, other = (
        world.recorded_poses(motion(w, q0, v0, n_steps=100, dt=DT)[0])
        for w in (world, world_with(world, {"gravity": {"g_ms2": 8.81}}))
    )
    assert displacement_between(one, other, DT, world.object) == pytest.approx(0.5 * (50 * DT) ** 2, rel=1e-3)


def test_a_push_is_a_known_motion() -> None:
    """A constant force on a flying body: the library's own and the audit's kicks agree."""
    world = cube_world()
    q0, v0 = throws(4)
    q0[:, 2] += 50
    force = np.array([0.3, -0.2, 0.0])
    pushed, _ = motion(world, q0, v0, n_steps=80, dt=DT, push=lambda t, q, v: np.tile(force, (len(q), 1)))
    there = world_with(world, {"uniform_force": {"x_n": 0.3, "y_n": -0.2}})
    np.testing.assert_allclose(pushed, motion(there, q0, v0, n_steps=80, dt=DT)[0], atol=1e-8)
