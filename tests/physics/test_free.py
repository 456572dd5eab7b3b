"""The learned acceleration of free motion: its features, and the frame that it acts in."""

from __future__ import annotations

import numpy as np

from tests.physics.trees import random_state, random_tree
from tossid.physics import LearnedAcceleration, free, make_system, n_features, tree
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
    expected = np.concatenate([R[2], np.linalg.norm(v[:3]) * R.T @ v[:3], 0.1 * v[3:6], np.ravel(joints)])
    assert len(expected) == n_features(2)
    np.testing.assert_allclose(work.feature, expected, atol=1e-12)


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
