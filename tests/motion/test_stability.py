"""Static stability, centre of mass, and stillness, by hand."""

from __future__ import annotations

import numpy as np

from tossid.motion.stability import center_of_mass, mean_pose, near, stands, still_for
from tossid.objects import ObjectModel
from tossid.rotations import quat_exp, quat_mul, quat_normalize


def test_a_cube_stands_on_a_face_and_not_on_an_edge(cube: ObjectModel, elbow: ObjectModel) -> None:
    rng = np.random.default_rng(5)
    for _ in range(10):
        yaw = quat_exp(np.array([0.0, 0.0, rng.uniform(0, 6)]))
        flat = np.array([*rng.normal(size=3), *yaw])
        assert stands(cube, flat)
        edge = np.array([0.0, 0.0, 0.1, *quat_mul(yaw, quat_exp(np.array([rng.uniform(0.2, 1.3), 0.0, 0.0])))])
        assert not stands(cube, edge)
        corner = np.array([0.0, 0.0, 0.1, *quat_normalize(quat_mul(yaw, quat_exp(np.array([0.6, 0.6, 0.0]))))])
        assert not stands(cube, corner)
    assert stands(elbow, np.array([0.0, 0.0, 0.025, 1.0, 0.0, 0.0, 0.0, 0.0]))
    com = center_of_mass(elbow, np.array([[0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0]]))[0]
    np.testing.assert_allclose(com, [0.0, 0.03, 0.0], atol=1e-12)


def test_the_mean_of_attitudes_of_either_sign_is_the_attitude() -> None:
    quat = quat_exp(np.array([0.3, -0.2, 0.1]))
    q = np.array([[0.0, 0.0, z, *(sign * quat)] for z, sign in ((0.1, 1), (0.2, -1), (5.0, 1))])
    pose = mean_pose(q)
    assert pose[2] == 0.2
    np.testing.assert_allclose(np.abs(pose[3:7] @ quat), 1.0, atol=1e-12)


def test_a_pose_is_still_if_it_is_the_same_half_a_span_and_a_span_later() -> None:
    q = np.tile([0.0, 0.0, 0.1, 1.0, 0.0, 0.0, 0.0], (10, 1))
    q[7:, 0] = 0.01
    np.testing.assert_array_equal(np.flatnonzero(still_for(q, 4, 1e-3, 1e-3)), [0, 1, 2])
    turned = q[:1].copy()
    turned[0, 3:7] = quat_exp(np.array([0.02, 0.0, 0.0]))
    assert not near(turned, q[0], 1e-3, 0.01)[0]
    assert near(turned, q[0], 1e-3, 0.03)[0]
