"""Inertia and friction from the balance of momentum, whatever the law of contact is."""

from __future__ import annotations

import numpy as np
import pytest

from tests.motion.conftest import Tossed
from tests.physics.trees import random_tree
from tossid.motion.momentum.balance import Balance
from tossid.motion.momentum.dynamics import TreeDynamics
from tossid.motion.momentum.estimate import momentum_balance
from tossid.motion.smoothing.system import difference, moved
from tossid.objects import object_from_mjcf
from tossid.physics import make_system
from tossid.physics.batch import free_accelerations
from tossid.physics.identifiable import inertia_error
from tossid.rotations import quat_to_matrix
from tossid.types import Phase

N, GRAVITY = 20, 9.81


@pytest.mark.parametrize("n_bodies", [1, 2, 3])
def test_free_motion_of_a_tree_about_its_centre_of_mass(n_bodies: int) -> None:
    """Accelerations are the simulator's, coordinates go there and back, energy stays, and derivatives are right."""
    tree, rng = random_tree(np.random.default_rng(n_bodies), n_bodies=n_bodies), np.random.default_rng(4)
    dynamics, inertia, nv = TreeDynamics(tree, GRAVITY), tree.inertia, tree.nv
    q, v = rng.normal(size=(N, tree.nq)), 3 * rng.normal(size=(N, nv))
    q[:, 3:7] /= np.linalg.norm(q[:, 3:7], axis=1, keepdims=True)

    expected = free_accelerations(make_system(tree, gravity=GRAVITY), q, v)
    found = dynamics.acceleration(dynamics.kinematics(q, v), inertia)
    np.testing.assert_allclose(found[:, 3:], expected[:, 3:], rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(found[:, :3], [[0, 0, -GRAVITY]] * N)

    u = np.concatenate([dynamics.com_velocity(q, v), v[:, 3:]], axis=1)
    back_q, back_v = dynamics.at_origin(dynamics.about_com(q), u)
    np.testing.assert_allclose(back_q, q, atol=1e-12)
    np.testing.assert_allclose(back_v, v, atol=1e-12)
    np.testing.assert_allclose(np.einsum("nij,nj->ni", dynamics.com_jacobian(q), v), u[:, :3], atol=1e-12)

    def ahead(q: np.ndarray, v: np.ndarray, h: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return dynamics.ahead(q, v, h, inertia, dynamics.half_way(q, v, h, inertia))

    def energy_of_spins(q: np.ndarray, v: np.ndarray) -> np.ndarray:
        own = np.concatenate([np.zeros((N, 3)), v[:, 3:]], axis=1)
        own[:, :3] -= dynamics.com_velocity(q, own)
        M = dynamics.mass_matrix(dynamics.kinematics(q, v), inertia)
        return 0.5 * np.einsum("ni,nij,nj->n", own, M, own)

    q = dynamics.about_com(q)
    before = energy_of_spins(q, v)
    for h, limit in ((2e-3, 2e-5), (1e-3, 4e-6)):  # an error of the third order in a step
        assert np.abs(energy_of_spins(*ahead(q, v, np.full(N, h))) / before - 1).max() < limit

    h, d = np.full(N, 0.005), 1e-5
    F = dynamics.transition(q, v, h, inertia)
    for i in range(2 * nv):
        error = d * np.eye(2 * nv)[i]
        (q_up, v_up), (q_down, v_down) = (
            ahead(moved(q, np.broadcast_to(sign * error[:nv], v.shape)), v + sign * error[nv:], h) for sign in (1, -1)
        )
        expected = np.concatenate([difference(q_up, q_down), v_up - v_down], axis=1) / (2 * d)
        np.testing.assert_allclose(F[:, :, i], expected, atol=2e-4)


def test_mass_matrix_of_a_dumbbell() -> None:
    """Two masses of 1 kg, 0.2 m apart: 2 m (0.1 m)² across their line, about the middle."""
    lump = '<geom type="box" size="0.01 0.01 0.01" mass="1" pos="{} 0 0"/>'
    text = f"<mujoco><worldbody><body><freejoint/>{lump.format(-0.1)}{lump.format(0.1)}</body></worldbody></mujoco>"
    model = object_from_mjcf(text, friction=0.2, width=0.2)
    dynamics, own = TreeDynamics(model, GRAVITY), 2 * 2 / 3 * 0.01**2
    M = dynamics.mass_matrix(dynamics.kinematics(np.eye(7)[3:4], np.zeros((1, 6))), model.inertia)[0]
    np.testing.assert_allclose(np.diag(M), [2, 2, 2, own, 0.02 + own, 0.02 + own], rtol=1e-6)


@pytest.mark.slow
def test_the_true_body_leaves_white_noise_in_flight_and_a_wrong_one_does_not(wedge: Tossed) -> None:
    I, mu = wedge.true.inertia, wedge.true.friction
    balance = Balance(wedge.tosses, wedge.true, GRAVITY)
    balance.linearise(I)
    flying = np.cumprod(~balance.touching.any(axis=-1), axis=0).astype(bool)  # until the first contact
    size = (balance.residuals(I)[2:] ** 2).mean(axis=-1)[flying[1:]]  # the first two frames start the filter
    assert len(size) > 200
    assert size.mean() == pytest.approx(1.0, abs=0.1)
    assert not (balance.sliding & ~balance.touching).any()
    assert balance.sliding.any()
    for i, toss in enumerate(wedge.tosses):
        n = int(np.argmax(toss.phase != Phase.FLIGHT)) - 2
        assert not balance.touching[: max(n, 0), i].any()

    def misfit(inertia: np.ndarray, friction: float | None = None) -> float:
        return float((balance.residuals(inertia, friction) ** 2).sum())

    assert min(misfit(0.85 * I), misfit(1.15 * I)) > misfit(I) + 20
    assert min(misfit(I, mu - 0.05), misfit(I, mu + 0.05)) > misfit(I, mu) + 20


@pytest.mark.slow
def test_inertia_and_friction_are_found_from_an_uneven_start(wedge: Tossed, linked: Tossed) -> None:
    R = quat_to_matrix(np.array([0.9, 0.3, 0.2, 0.25]) / np.linalg.norm([0.9, 0.3, 0.2, 0.25]))
    I = wedge.true.inertia
    found = momentum_balance(wedge.tosses, wedge.true.with_changes(inertia=1.4 * R @ I @ R.T, friction=0.4))
    assert np.linalg.norm(found.inertia - I) < 0.06 * np.linalg.norm(I)
    assert found.inertia_deviation < 0.05
    assert found.friction == pytest.approx(wedge.true.friction, abs=0.01)
    assert found.friction_deviation < 0.01
    true = linked.true
    start = true.with_changes(inertia=np.array([1.3, 0.8])[:, None, None] * true.inertia, friction=0.4)
    assert inertia_error(start, true) > 0.15
    found = momentum_balance(linked.tosses, start)
    assert inertia_error(true.with_changes(inertia=found.inertia), true) < 0.02
    assert found.inertia_deviation < 0.01
    assert found.friction == pytest.approx(true.friction, abs=0.01)


def test_flight_alone_shows_no_friction(wedge: Tossed) -> None:
    found = momentum_balance([toss.frames(slice(20)) for toss in wedge.tosses], wedge.true)
    assert (found.friction, found.friction_deviation) == (None, np.inf)
    assert found.inertia_deviation > 0.05  # the absolute size needs a contact


def test_where_the_filter_breaks_down_nothing_is_determined(wedge: Tossed, monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(balance, inertia, mu=None):
        return np.linalg.cholesky(-np.eye(6))

    monkeypatch.setattr(Balance, "residuals", broken)
    found = momentum_balance(wedge.tosses, wedge.true)
    np.testing.assert_array_equal(found.inertia, wedge.true.inertia)
    assert (found.inertia_deviation, found.friction) == (0.5, None)
