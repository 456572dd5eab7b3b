"""M(q), bias and Jacobians against MuJoCo, to 1e-9."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from tests.physics.trees import random_state, random_tree
from tossid.physics import free, tree
from tossid.physics.system import make_system


@pytest.mark.parametrize("seed", range(12))
def test_mass_matrix_bias_and_jacobians_agree_with_mujoco(seed: int) -> None:
    rng = np.random.default_rng(seed)
    model = random_tree(rng, n_bodies=1 + seed % 5)
    m = mujoco.MjModel.from_xml_string(model.mjcf)
    m.opt.gravity[:] = [0.3, -0.2, -9.81]
    d = mujoco.MjData(m)
    system = make_system(model, gravity=[0.3, -0.2, -9.81])
    work = tree.make_work(system)
    for _ in range(5):
        q, v = random_state(rng, model)
        d.qpos[:], d.qvel[:] = q, v
        mujoco.mj_forward(m, d)
        M = np.zeros((m.nv, m.nv))
        mujoco.mj_fullM(m, d, M)
        acc = np.zeros(system.nv)
        assert free.free_acceleration(system, q, v, work, acc)
        factor = np.tril(work.L)
        np.testing.assert_allclose(factor @ factor.T, M, rtol=0, atol=1e-9)
        tree.kinematics(system, q, work)
        tree.mass_matrix(system, work)
        tree.bias_force(system, q, v, work)
        np.testing.assert_allclose(work.M, M, rtol=0, atol=1e-9)
        np.testing.assert_allclose(work.bias, d.qfrc_bias, rtol=0, atol=1e-9 * max(1, np.abs(d.qfrc_bias).max()))
        np.testing.assert_allclose(M @ acc + d.qfrc_bias, 0, atol=1e-9 * max(1, np.abs(d.qfrc_bias).max()))
        np.testing.assert_allclose(work.xpos, d.xpos[1:], atol=1e-12)
        for body in range(model.n_bodies):
            point = d.xpos[body + 1] + rng.normal(size=3) * 0.1
            J, J_mujoco = np.zeros((3, m.nv)), np.zeros((3, m.nv))
            tree.point_jacobian(system, work, body, point, J)
            mujoco.mj_jac(m, d, J_mujoco, None, point, body + 1)
            np.testing.assert_allclose(J, J_mujoco, rtol=0, atol=1e-9)


def test_configuration_steps_like_mujoco() -> None:
    rng = np.random.default_rng(0)
    model = random_tree(rng, n_bodies=3)
    m = mujoco.MjModel.from_xml_string(model.mjcf)
    q, v = random_state(rng, model)
    moved, expected = np.empty(model.nq), q.copy()
    tree.integrate_configuration(q, v, 0.01, moved)
    mujoco.mj_integratePos(m, expected, v, 0.01)
    np.testing.assert_allclose(moved, expected, atol=1e-12)
