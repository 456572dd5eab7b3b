"""Forward kinematics against MuJoCo's own, for random trees."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from tests.physics.trees import random_state, random_tree
from tossid.objects import ObjectModel, body_poses, center_positions, corner_heights, corner_positions
from tossid.rotations import geodesic_angle


@pytest.mark.parametrize("seed", range(10))
def test_poses_and_corners_are_mujocos(seed: int) -> None:
    rng = np.random.default_rng(seed)
    model = random_tree(rng, n_bodies=1 + seed % 5)
    m = mujoco.MjModel.from_xml_string(model.mjcf)
    d = mujoco.MjData(m)
    q, _ = random_state(rng, model)
    d.qpos[:] = q
    mujoco.mj_kinematics(m, d)
    pos, quat = body_poses(model, q)
    np.testing.assert_allclose(pos, d.xpos[1:], atol=1e-12)
    assert geodesic_angle(quat, d.xquat[1:]).max() < 1e-7

    signs = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], dtype=float)
    boxes = [signs * m.geom_size[g] @ d.geom_xmat[g].reshape(3, 3).T + d.geom_xpos[g] for g in range(m.ngeom)]
    corners = corner_positions(model, q)
    np.testing.assert_allclose(corner_heights(model, q), corners[..., 2], atol=1e-12)
    for body in range(model.n_bodies):
        mine = corners[model.corner_body == body]
        gaps = np.linalg.norm(mine[:, None] - boxes[body][None], axis=-1)
        assert gaps.min(axis=1).max() < 1e-12


def test_batches_are_their_members() -> None:
    rng = np.random.default_rng(0)
    model = random_tree(rng, n_bodies=3)
    q = np.array([random_state(rng, model)[0] for _ in range(6)]).reshape(2, 3, -1)
    corners, centers = corner_positions(model, q), center_positions(model, q)
    for i in np.ndindex(2, 3):
        np.testing.assert_allclose(corners[i], corner_positions(model, q[i]), atol=1e-15)
        np.testing.assert_allclose(centers[i], center_positions(model, q[i]), atol=1e-15)


def test_the_centre_follows_the_base(cube: ObjectModel) -> None:
    moved = cube.with_changes(corner_pos=cube.corner_pos + np.array([0.01, 0.0, 0.0]))
    q = np.array([1.0, 2.0, 3.0, np.sqrt(0.5), 0.0, 0.0, np.sqrt(0.5)])  # a quarter turn about z
    np.testing.assert_allclose(center_positions(moved, q), [1.0, 2.01, 3.0], atol=1e-15)
