"""M(q), bias and Jacobians against MuJoCo, to 1e-9; the stepping kernels against them."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from tests.physics.trees import random_state, random_tree
from tossid.physics import LearnedAcceleration, System, free, simulate, tree
from tossid.physics.contact import problem as contact
from tossid.physics.solvers import solve_contacts
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


def tossed(rng: np.random.Generator, n_bodies: int) -> tuple[System, np.ndarray, np.ndarray]:
    """A random tree with a random learned acceleration over the ground, and 30 states of it."""
    model = random_tree(rng, n_bodies=n_bodies)
    nv, nf = model.nv, 6 + 3 * n_bodies
    shapes = ((nv, nf), (8, nf), (8,), (8, 8), (8,), (nv, 8))
    k_res = LearnedAcceleration(*(0.1 * rng.normal(size=shape) for shape in shapes))
    system = make_system(model, gravity=[0.3, -0.2, -9.81], friction=0.3, k_res=k_res)
    q, v = map(np.array, zip(*(random_state(rng, model) for _ in range(30)), strict=True))
    q[:, 2] = rng.uniform(0.05, 0.2, 30)
    q[:, 7:] *= 0.5
    return system, q, v


def plain_step(system: System, q: np.ndarray, v: np.ndarray, h: float) -> tuple[np.ndarray, np.ndarray]:
    """v' and the normal impulses (n_c,) of one step, with every corner in the problem: no candidates, no shortcuts."""
    work, a = tree.make_work(system), np.zeros(system.nv)
    assert free.free_acceleration(system, q, v, work, a)
    vf, n = v + h * a, system.n_corners
    J, phi = np.zeros((3 * n, system.nv)), np.zeros(n)
    for c, body in enumerate(system.corner_body):
        point, rows = work.xpos[body] + work.xmat[body] @ system.corner_pos[c], np.zeros((3, system.nv))
        tree.point_jacobian(system, work, body, point, rows)
        phi[c], J[c], J[n + 2 * c : n + 2 * c + 2] = point[2], rows[2], rows[:2]
    if system.compliance == 0 and system.relaxation == 0:
        phi = np.maximum(phi, 0.0)  # rigid ground gives way below what begins in it
    b = J @ vf
    soft = (phi < 0) | (phi + h * b[:n] < 0)
    # a spring at the step's end damps by k h, which is taken off its damper
    recovery_time = h + system.relaxation if system.compliance == 0 else np.hypot(h, system.relaxation)
    b[:n] += phi / np.where(soft, recovery_time, h)
    A = J @ np.linalg.solve(work.M, J.T)
    slack = system.compliance / (h * recovery_time)
    A += slack * np.diag(np.r_[np.ones(n), np.full(2 * n, contact.TANGENTIAL)])
    found = solve_contacts(A[None], b[None], system.mu[None], tolerance=1e-11)
    assert found.status[0] == 0
    return vf + np.linalg.solve(work.M, J.T @ found.lam[0]), found.lam[0, :n]


@pytest.mark.parametrize(("compliance", "relaxation"), [(0.0, 0.0), (3e-5, 4e-3), (3e-5, 0.02), (0.0, 4e-3)])
@pytest.mark.parametrize("n_bodies", [2, 3, 5])
def test_steps_of_trees_are_those_of_the_plain_equations(n_bodies: int, compliance: float, relaxation: float) -> None:
    h = 1 / 148
    system, q, v = tossed(np.random.default_rng(n_bodies), n_bodies)
    system = system._replace(compliance=compliance, relaxation=relaxation)
    run = simulate(system, q, v, n_steps=1, dt=h, tolerance=1e-11)
    assert run.unsolved.sum() == 0
    hits = 0
    for k in range(len(q)):
        expected, lam = plain_step(system, q[k], v[k], h)
        if (lam > 0).sum() > 2:  # more than two need not have one solution
            continue
        hits += int((lam > 0).any())
        np.testing.assert_allclose(run.v[k, 1], expected, rtol=0, atol=1e-8)
        np.testing.assert_allclose(run.lam_n[k, 0], lam, rtol=0, atol=1e-9)
    assert hits >= 5


def test_a_tree_whose_inertia_is_no_body_s_is_reported() -> None:
    system, q, v = tossed(np.random.default_rng(0), 3)
    run = simulate(system._replace(inertia=-system.inertia), q, v, n_steps=5, dt=0.01)
    assert not run.finite.any()
    assert np.isfinite(run.q).all()
