"""Free motion of a tree about its common centre of mass, beside the simulator's and conservation."""

from __future__ import annotations

import numpy as np
import pytest

from tests.physics.trees import random_tree
from tossid.motion.momentum.dynamics import TreeDynamics
from tossid.motion.smoothing.system import difference, moved
from tossid.objects import ObjectModel, object_from_mjcf
from tossid.physics import make_system
from tossid.physics.free import free_acceleration
from tossid.physics.tree import make_work

N = 20
GRAVITY = 9.81


@pytest.fixture(params=[1, 2, 3])
def tree(request: pytest.FixtureRequest) -> ObjectModel:
    return random_tree(np.random.default_rng(request.param), n_bodies=request.param)


@pytest.fixture
def states(tree: ObjectModel) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(4)
    q = rng.normal(size=(N, tree.nq))
    q[:, 3:7] /= np.linalg.norm(q[:, 3:7], axis=1, keepdims=True)
    return q, 3 * rng.normal(size=(N, tree.nv))


def test_accelerations_are_those_of_the_simulator(tree, states):
    q, v = states
    dynamics = TreeDynamics(tree, GRAVITY)
    system = make_system(tree, gravity=GRAVITY)
    work, expected = make_work(system), np.zeros_like(v)
    for i in range(N):
        assert free_acceleration(system, q[i], v[i], work, expected[i])
    found = dynamics.acceleration(dynamics.kinematics(q, v), tree.inertia)
    np.testing.assert_allclose(found[:, 3:], expected[:, 3:], rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(found[:, :3], [[0, 0, -GRAVITY]] * N)


def test_states_go_to_the_centre_of_mass_and_back(tree, states):
    q, v = states
    dynamics = TreeDynamics(tree, GRAVITY)
    u = np.concatenate([dynamics.com_velocity(q, v), v[:, 3:]], axis=1)
    back_q, back_v = dynamics.at_origin(dynamics.about_com(q), u)
    np.testing.assert_allclose(back_q, q, atol=1e-12)
    np.testing.assert_allclose(back_v, v, atol=1e-12)
    np.testing.assert_allclose(np.einsum("nij,nj->ni", dynamics.com_jacobian(q), v), u[:, :3], atol=1e-12)


def test_a_frame_ahead_keeps_the_energy_of_spins(tree, states):
    q, v = states
    dynamics, inertia = TreeDynamics(tree, GRAVITY), tree.inertia
    q = dynamics.about_com(q)

    def energy(q: np.ndarray, v: np.ndarray) -> np.ndarray:
        own = np.concatenate([np.zeros((N, 3)), v[:, 3:]], axis=1)
        own[:, :3] -= dynamics.com_velocity(q, own)
        M = dynamics.mass_matrix(dynamics.kinematics(q, v), inertia)
        return 0.5 * np.einsum("ni,nij,nj->n", own, M, own)

    before = energy(q, v)
    for h, limit in ((np.full(N, 2e-3), 2e-5), (np.full(N, 1e-3), 4e-6)):  # an error of the third order in a step
        after = energy(*dynamics.ahead(q, v, h, inertia, dynamics.half_way(q, v, h, inertia)))
        assert np.abs(after / before - 1).max() < limit


def test_derivatives_by_the_state_are_those_of_differences(tree, states):
    q, v = states
    dynamics, inertia, h, nv, d = TreeDynamics(tree, GRAVITY), tree.inertia, np.full(N, 0.005), tree.nv, 1e-5

    def ahead(error: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        a, b = moved(q, np.broadcast_to(error[:nv], v.shape)), v + error[nv:]
        return dynamics.ahead(a, b, h, inertia, dynamics.half_way(a, b, h, inertia))

    F = dynamics.transition(q, v, h, inertia)
    for i in range(2 * nv):
        error = np.zeros(2 * nv)
        error[i] = d
        (q_up, v_up), (q_down, v_down) = ahead(error), ahead(-error)
        expected = np.concatenate([difference(q_up, q_down), v_up - v_down], axis=1) / (2 * d)
        np.testing.assert_allclose(F[:, :, i], expected, atol=2e-4)


def test_mass_matrix_of_a_dumbbell() -> None:
    """Two masses of 1 kg, 0.2 m apart: 2 m (0.1 m)² across their line, about the middle."""
    lump = '<geom type="box" size="0.01 0.01 0.01" mass="1" pos="{} 0 0"/>'
    text = f"<mujoco><worldbody><body><freejoint/>{lump.format(-0.1)}{lump.format(0.1)}</body></worldbody></mujoco>"
    model = object_from_mjcf(text, friction=0.2, width=0.2)
    dynamics = TreeDynamics(model, GRAVITY)
    q = np.array([[0.0, 0, 0, 1, 0, 0, 0]])
    M = dynamics.mass_matrix(dynamics.kinematics(q, np.zeros((1, 6))), model.inertia)[0]
    own = 2 * 2 / 3 * 0.01**2
    np.testing.assert_allclose(np.diag(M), [2, 2, 2, own, 0.02 + own, 0.02 + own], rtol=1e-6)
