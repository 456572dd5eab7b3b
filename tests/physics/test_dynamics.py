"""Free motion of trees: kinematics, mass matrix and bias beside MuJoCo's, and the learned acceleration."""

from __future__ import annotations

import mujoco
import numba
import numpy as np
import pytest

from tests.physics.trees import random_state, random_tree
from tossid.kernels import kernel
from tossid.objects import ObjectModel, corner_positions
from tossid.physics import LearnedAcceleration, System, make_system, n_features, network, simulate, tree_batch
from tossid.physics.batch import free_accelerations, mass_matrices, mass_norms
from tossid.physics.body import make_body
from tossid.physics.contact.impacts import falling
from tossid.physics.contact.law import Law
from tossid.physics.contact.problem import find_corners, find_rows, make_corners
from tossid.physics.links import make_links
from tossid.physics.moving import common_velocity, inverse_mass, make_state, turning, whiten
from tossid.physics.step_motion import find_accelerations, rotation, turned
from tossid.rotations import quat_exp, quat_mul, quat_to_matrix

GRAVITY = [0.3, -0.2, -9.81]


def states(rng: np.random.Generator, model: ObjectModel, count: int) -> tuple[np.ndarray, np.ndarray]:
    q, v = zip(*(random_state(rng, model) for _ in range(count)), strict=True)
    return np.array(q), np.array(v)


@pytest.mark.parametrize("seed", range(8))
def test_kinematics_mass_and_accelerations_are_mujocos(seed: int) -> None:
    rng = np.random.default_rng(seed)
    model = random_tree(rng, n_bodies=1 + seed % 5)
    m = mujoco.MjModel.from_xml_string(model.mjcf)
    m.opt.gravity[:] = GRAVITY
    d, system, (q, v) = mujoco.MjData(m), make_system(model, gravity=GRAVITY), states(rng, model, 5)
    batch = tree_batch(system, q, v)
    M, acceleration = mass_matrices(batch, system), free_accelerations(system, q, v)
    np.testing.assert_allclose(
        mass_norms(system, q, acceleration), np.sqrt(np.einsum("ni,nij,nj->n", acceleration, M, acceleration))
    )
    for k in range(5):
        d.qpos[:], d.qvel[:] = q[k], v[k]
        mujoco.mj_forward(m, d)
        expected, J = np.zeros((m.nv, m.nv)), np.zeros((2, 3, m.nv))
        mujoco.mj_fullM(m, d, expected)
        size = max(1, np.abs(d.qfrc_bias).max())
        np.testing.assert_allclose(M[k], expected, rtol=0, atol=1e-9)
        np.testing.assert_allclose(expected @ acceleration[k] + d.qfrc_bias, 0, atol=1e-9 * size)
        np.testing.assert_allclose(batch.x[k], d.xpos[1:], atol=1e-12)
        for b in range(model.n_bodies):
            mujoco.mj_jac(m, d, J[1], J[0], d.xpos[b + 1], b + 1)
            own = np.concatenate([batch.R[k, b].T @ part for part in J])
            np.testing.assert_allclose(batch.X[k, b], own, rtol=0, atol=1e-9)


# ---------------------------------------------------------------- what the time step asks of an object


@kernel(keep=False)
def rows(model, k_res, work, s, corners, radius, out):  # type: ignore[no-untyped-def]
    """All corners' rows, their whitened columns, and (n_c, 4): dJ_k/dt v along k, and the free vertical acceleration.

    Returns 1 / m and the common centre's velocity from the origin's, base's axes.
    """
    find_accelerations(model, k_res, work, s, 1e-3)
    find_corners(model, work, s, corners, radius, 1e3)
    find_rows(model, work, s, corners, radius)
    for c in range(corners.state.shape[0]):
        for k in range(3):
            whiten(model, work, corners, c, k, 3 * c + k)
            out[c, k] = turning(model, work, s, corners, c, k)
        out[c, 3] = falling(model, work, s, corners, c)
    return inverse_mass(model, work), common_velocity(model, work, s.xi_start, 0)


@pytest.mark.parametrize(("n_bodies", "kind"), [(1, make_body), (1, make_links), (3, make_links)])
@pytest.mark.parametrize("rounding", [0.0, 0.004])
def test_rows_are_velocities_and_give_the_delassus_matrix(kind, n_bodies: int, rounding: float) -> None:  # type: ignore[no-untyped-def]
    rng = np.random.default_rng(n_bodies)
    model = random_tree(rng, n_bodies=n_bodies)
    (q, v), system = random_state(rng, model), make_system(model)._replace(law=Law(rounding=rounding))
    nc, nx = system.n_corners, system.nv - 3
    given, s, corners = kind(system), make_state(system.nq, system.nv, 0), make_corners(nc, nx)
    s.q[:], s.v[:] = q, v
    out = np.zeros((nc, 4))
    model = model.with_changes(corner_pos=given.corner_pos)  # centres of spheres
    over_m, moved = rows(given, network.make_network(system.k_res), given.make_work(), s, corners, rounding, out)
    assert over_m == pytest.approx(1 / model.mass.sum())
    u = v[:3] + s.R @ np.array(moved)

    def corners_at(h: float, a: np.ndarray = np.zeros(system.nv)) -> np.ndarray:
        mean = v + 0.5 * h * a
        spun = quat_mul(q[3:7], quat_exp(h * mean[3:6]))
        return corner_positions(model, np.r_[q[:3] + h * mean[:3], spun, q[7:] + h * mean[6:]])

    speed = (corners_at(1e-6) - corners_at(-1e-6)) / 2e-6
    free = np.r_[given.gravity - s.R @ s.a, s.rate]
    bent = [(corners_at(1e-4, a) - 2 * corners_at(0.0) + corners_at(-1e-4, a)) / 1e-8 for a in (0 * free, free)]
    # a sphere's lowest point goes up and down as its centre does
    np.testing.assert_allclose(u[2] + corners.tau[:, 0] @ v[3:], speed[:, 2], atol=1e-7)
    np.testing.assert_allclose(out[:, 3], bent[1][:, 2], atol=2e-5 * np.abs(bent[1]).max())
    for k, axis in enumerate((2, 0, 1)):
        np.testing.assert_allclose(out[:, k], bent[0][:, axis], atol=2e-5 * np.abs(bent[0]).max())
    if rounding == 0.0:
        for k, axis in ((1, 0), (2, 1)):
            np.testing.assert_allclose(u[axis] + corners.tau[:, k] @ v[3:], speed[:, axis], atol=1e-7)
        J, M = contact_jacobian(system, q, v), mass_matrices(tree_batch(system, q[None], v[None]), system)[0]
        expected = J @ np.linalg.solve(M, J.T)
        A = corners.G.T @ corners.G + over_m * np.kron(np.ones((nc, nc)), np.eye(3))
        np.testing.assert_allclose(A, expected, atol=1e-9 * np.abs(expected).max())


def contact_jacobian(system: System, q: np.ndarray, v: np.ndarray) -> np.ndarray:
    """(3 n_c, nv), of each corner in turn along the world's z, x and y."""
    batch, body = tree_batch(system, q[None], v[None]), system.corner_body
    angular, linear = batch.X[0, body, :3], batch.X[0, body, 3:]
    across = np.cross(angular.swapaxes(1, 2), system.corner_pos[:, None]).swapaxes(1, 2)
    return np.asarray((batch.R[0, body] @ (linear + across))[:, [2, 0, 1]].reshape(-1, system.nv))


@kernel(keep=False)
def turned_by(q, x, R):  # type: ignore[no-untyped-def]
    rotation(q, R)
    return turned(q[3], q[4], q[5], q[6], x[0], x[1], x[2])


def test_a_step_s_rotation_is_the_exponential() -> None:
    rng = np.random.default_rng(0)
    for size in (0.0, 1e-8, 1e-3, 0.1, 0.199, 0.201, 1.0, 3.0):
        q, x, R = rng.normal(size=4), rng.normal(size=3), np.empty((3, 3))
        q, x = q / np.linalg.norm(q), size * x / np.linalg.norm(x)
        np.testing.assert_allclose(turned_by(np.r_[np.zeros(3), q], x, R), quat_mul(q, quat_exp(2 * x)), atol=2e-15)
        np.testing.assert_allclose(R, quat_to_matrix(q), atol=1e-15)


# ---------------------------------------------------------------- the learned acceleration


@numba.njit
def evaluated(k_res, f, hidden, out):  # type: ignore[no-untyped-def]
    """What only kernels may call."""
    network.network(k_res, f, hidden, out)


@numba.njit
def tanh_of(x, out):  # type: ignore[no-untyped-def]
    for i in range(len(x)):
        out[i] = network.tanh(x[i])


@pytest.mark.parametrize("hidden", [1, 6, 8, 19])
def test_two_hidden_layers_and_a_linear_part(hidden: int) -> None:
    rng = np.random.default_rng(0)
    shapes = ((6, 9), (hidden, 9), (hidden,), (hidden, hidden), (hidden,), (6, hidden))
    k = LearnedAcceleration(*(rng.normal(size=shape) for shape in shapes))
    f, out = rng.normal(size=9), np.empty(6)
    evaluated(network.make_network(k), f, np.zeros((2, hidden)), out)
    expected = k.linear @ f + k.W2 @ np.tanh(k.W1 @ np.tanh(k.W0 @ f + k.b0) + k.b1)
    np.testing.assert_allclose(out, expected, rtol=1e-13, atol=1e-13)
    np.testing.assert_allclose(network.learned_accelerations(k, f[None], 6)[0], expected, rtol=1e-13, atol=1e-13)


def test_tanh_is_numpys_to_rounding() -> None:
    x = np.concatenate([np.linspace(-30, 30, 100_001), 10.0 ** -np.linspace(0, 300, 1000), [0.0, np.inf, -np.inf]])
    out = np.empty_like(x)
    tanh_of(x, out)
    np.testing.assert_allclose(out, np.tanh(x), rtol=0, atol=3e-16)
    tanh_of(np.array([np.nan]), out[:1])
    assert np.isnan(out[0])


def test_features_are_what_the_base_sees() -> None:
    rng = np.random.default_rng(0)
    model = random_tree(rng, n_bodies=3)
    q, v = random_state(rng, model)
    R = quat_to_matrix(q[3:7])
    joints = [[np.sin(a), np.cos(a), 0.1 * r] for a, r in zip(q[7:], v[6:], strict=True)]
    body = np.concatenate([R[2], np.linalg.norm(v[:3]) * R.T @ v[:3], 0.1 * v[3:6], np.ravel(joints)])
    expected = np.concatenate([body, R[0], R[1], [1.0], q[:3], v[:3]])
    assert (len(body), len(expected)) == (n_features(2), n_features(2, world=True))
    np.testing.assert_allclose(tree_batch(make_system(model), q[None], v[None]).features[0], expected, atol=1e-12)
    assert free_accelerations(make_system(model), np.zeros((0, model.nq)), np.zeros((0, model.nv))).shape == (0, 8)


@pytest.mark.parametrize("n_bodies", [1, 2])
def test_the_time_step_has_the_same_field(n_bodies: int) -> None:
    rng = np.random.default_rng(3)
    model = random_tree(rng, n_bodies=n_bodies)
    q, v = random_state(rng, model)
    q[2] += 50.0
    n_out, n_f = 8 + n_bodies, n_features(n_bodies - 1, world=True)
    shapes = ((n_out, n_f), (8, n_f), (8,), (8, 8), (8,), (n_out, 8))
    k_res = LearnedAcceleration(*(0.3 * rng.normal(size=shape) for shape in shapes))
    system, dt = make_system(model, k_res=k_res), 1e-6
    after = simulate(system, q[None], v[None], n_steps=1, dt=dt).v[0, 1]
    np.testing.assert_allclose((after - v) / dt, free_accelerations(system, q[None], v[None])[0], rtol=1e-4, atol=1e-3)
