"""The learned acceleration of free motion: its features, and the frame that it acts in."""

from __future__ import annotations

import numpy as np

from tests.physics.trees import random_state, random_tree
from tossid.physics import (
    LearnedAcceleration,
    free,
    learned_accelerations,
    make_system,
    n_features,
    simulate,
    tree,
    tree_batch,
)
from tossid.rotations import quat_exp, quat_mul, quat_rotate, quat_to_matrix


def test_features_are_what_the_base_sees() -> None:
    rng = np.random.default_rng(0)
    model = random_tree(rng, n_bodies=3)
    (q, v), system = random_state(rng, model), make_system(model)
    work = tree.make_work(system)
    tree.kinematics(system, q, work)
    free.features(system, q, v, work)
    R = quat_to_matrix(q[3:7])
    joints = [[np.sin(a), np.cos(a), 0.1 * r] for a, r in zip(q[7:], v[6:], strict=True)]
    body = np.concatenate([R[2], np.linalg.norm(v[:3]) * R.T @ v[:3], 0.1 * v[3:6], np.ravel(joints)])
    assert len(body) == n_features(2)
    world = np.concatenate([R[0], R[1], [1.0], q[:3], v[:3]])
    assert len(body) + len(world) == n_features(2, world=True)
    np.testing.assert_allclose(work.feature, np.concatenate([body, world]), atol=1e-12)


def test_a_batch_is_its_states() -> None:
    rng = np.random.default_rng(3)
    model = random_tree(rng, n_bodies=3)
    system = make_system(model)
    q, v = (np.array(part) for part in zip(*(random_state(rng, model) for _ in range(4)), strict=True))
    work, found, norms = tree.make_work(system), free.free_accelerations(system, q, v), np.empty(4)
    free.mass_norms(system, q, found, work, norms)
    for i in range(4):
        own = np.empty(model.nv)
        assert free.free_acceleration(system, q[i], v[i], work, own)
        np.testing.assert_array_equal(found[i], own)
        np.testing.assert_allclose(norms[i], np.sqrt(own @ work.M @ own), rtol=1e-12)


def test_a_learned_acceleration_turns_with_the_object_about_the_vertical() -> None:
    rng = np.random.default_rng(1)
    model = random_tree(rng, n_bodies=2)
    nv, nf = model.nv, n_features(1)
    shapes = ((nv, nf), (8, nf), (8,), (8, 8), (8,), (nv, 8))
    system = make_system(model, k_res=LearnedAcceleration(*(0.3 * rng.normal(size=shape) for shape in shapes)))
    q, v = random_state(rng, model)
    turn = quat_exp(np.array([0.0, 0.0, 1.1]))
    other_q, other_v = q.copy(), v.copy()
    other_q[:3] += [3.0, -2.0, 1.0]
    other_q[3:7], other_v[:3] = quat_mul(turn, q[3:7]), quat_rotate(turn, v[:3])
    found = []
    for state in ((q, v), (other_q, other_v)):
        work, out = tree.make_work(system), np.zeros(nv)
        tree.kinematics(system, state[0], work)
        free.learned_acceleration(system, *state, work, out)
        found.append(out)
    assert np.abs(found[0]).max() > 0.1
    np.testing.assert_allclose(found[1][:3], quat_rotate(turn, found[0][:3]), atol=1e-12)
    np.testing.assert_allclose(found[1][3:], found[0][3:], atol=1e-12)


def test_a_field_acts_along_the_worlds_axes_whatever_the_attitude() -> None:
    """A spring towards a point, a vortex and a drag, as the linear part of a learned acceleration."""
    rng = np.random.default_rng(2)
    model = random_tree(rng, n_bodies=2)
    nv, nf = model.nv, n_features(1, world=True)
    linear = np.zeros((nv + 3, nf))
    stiffness, drag, swirl, centre = 3.0, 0.4, 1.5, np.array([0.2, -0.1, 0.3])
    linear[nv:, -7] = stiffness * centre
    linear[nv:, -6:-3] = -stiffness * np.eye(3) + swirl * np.array([[0, -1, 0], [1, 0, 0], [0, 0, 0]])
    linear[nv:, -3:] = -drag * np.eye(3)
    empty = np.zeros((0, nf)), np.zeros(0), np.zeros((0, 0)), np.zeros(0), np.zeros((nv + 3, 0))
    k_res = LearnedAcceleration(linear, *empty)
    system = make_system(model, k_res=k_res)
    q, v = random_state(rng, model)
    work, out = tree.make_work(system), np.zeros(nv)
    tree.kinematics(system, q, work)
    free.learned_acceleration(system, q, v, work, out)
    expected = stiffness * (centre - q[:3]) + swirl * np.array([-q[1], q[0], 0.0]) - drag * v[:3]
    np.testing.assert_allclose(out[:3], expected, atol=1e-12)
    assert not out[3:].any()
    batch = tree_batch(system, q[None], v[None])
    found = learned_accelerations(k_res, batch.features, nv)
    np.testing.assert_allclose(batch.R[0, 0] @ found[0, :3], expected, atol=1e-12)


def test_the_time_stepper_has_the_same_field_as_the_plain_kernel() -> None:
    rng = np.random.default_rng(3)
    for n_bodies in (1, 2):
        model = random_tree(rng, n_bodies=n_bodies)
        nv, nf = model.nv, n_features(n_bodies - 1, world=True)
        shapes = ((nv + 3, nf), (8, nf), (8,), (8, 8), (8,), (nv + 3, 8))
        k_res = LearnedAcceleration(*(0.3 * rng.normal(size=shape) for shape in shapes))
        q, v = random_state(rng, model)
        q[2] += 50.0
        system, dt = make_system(model, k_res=k_res), 1e-6
        after = simulate(system, q[None], v[None], n_steps=1, dt=dt).v[0, 1]
        work, out = tree.make_work(system), np.zeros(nv)
        assert free.free_acceleration(system, q, v, work, out)
        np.testing.assert_allclose((after - v) / dt, out, rtol=1e-4, atol=1e-3)
