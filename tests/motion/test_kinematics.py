"""Velocities of bodies against MuJoCo, and the measure of a jump."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from tests.physics.trees import random_state, random_tree
from tossid.motion.kinematics import body_motions, center_of_mass, com_velocities, corner_velocities, jump_speed
from tossid.objects import corner_positions
from tossid.rotations import quat_exp, quat_mul, quat_normalize


@pytest.mark.parametrize("seed", range(8))
def test_body_velocities_are_mujocos(seed: int) -> None:
    rng = np.random.default_rng(seed)
    model = random_tree(rng, n_bodies=1 + seed % 4)
    m = mujoco.MjModel.from_xml_string(model.mjcf)
    d = mujoco.MjData(m)
    d.qpos[:], d.qvel[:] = q, v = random_state(rng, model)
    mujoco.mj_forward(m, d)
    _, linear, angular = body_motions(model, q, v)
    for body in range(model.n_bodies):
        found = np.zeros(6)
        mujoco.mj_objectVelocity(m, d, mujoco.mjtObj.mjOBJ_XBODY, body + 1, found, 0)
        np.testing.assert_allclose(angular[body], found[:3], atol=1e-10)
        np.testing.assert_allclose(linear[body], found[3:], atol=1e-10)
        mujoco.mj_objectVelocity(m, d, mujoco.mjtObj.mjOBJ_BODY, body + 1, found, 0)
        np.testing.assert_allclose(com_velocities(model, q, v)[body], found[3:], atol=1e-10)
    np.testing.assert_allclose(center_of_mass(model, q), d.subtree_com[1], atol=1e-10)


@pytest.mark.parametrize("seed", range(4))
def test_corner_velocities_are_differences_of_positions(seed: int) -> None:
    rng = np.random.default_rng(seed)
    model = random_tree(rng, n_bodies=3)
    q, v = random_state(rng, model)

    def at(h: float) -> np.ndarray:
        turned = quat_normalize(quat_mul(q[3:7], quat_exp(h * v[3:6])))
        return corner_positions(model, np.concatenate([q[:3] + h * v[:3], turned, q[7:] + h * v[6:]]))

    numeric = (at(1e-6) - at(-1e-6)) / 2e-6
    np.testing.assert_allclose(corner_velocities(model, q, v), numeric, atol=1e-7)


@pytest.mark.parametrize("seed", range(4))
def test_a_jump_is_measured_by_its_kinetic_energy(seed: int) -> None:
    """Of what free fall does not explain."""
    rng = np.random.default_rng(seed)
    model = random_tree(rng, n_bodies=1 + seed)
    m = mujoco.MjModel.from_xml_string(model.mjcf)
    d, M = mujoco.MjData(m), np.zeros((model.nv, model.nv))
    d.qpos[:] = q = random_state(rng, model)[0]
    mujoco.mj_forward(m, d)
    mujoco.mj_fullM(m, d, M)
    before, step, fall = rng.normal(size=model.nv), rng.normal(size=model.nv), 9.81 / 148
    after = before + step - fall * np.eye(model.nv)[2]
    expected = np.sqrt(step @ M @ step / model.mass.sum())
    assert jump_speed(model, q, before, after, np.array(fall)) == pytest.approx(expected, rel=1e-9)
