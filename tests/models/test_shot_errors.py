"""Errors of predictions in the kernel are those of the plain formulas."""

from __future__ import annotations

import numpy as np

from tossid.models.shot_errors import fill_errors
from tossid.rotations import quat_boxminus, quat_normalize


def test_errors_are_differences_of_positions_rotation_vectors_and_joints() -> None:
    rng = np.random.default_rng(0)
    q, target = rng.normal(size=(5, 9, 9)), rng.normal(size=(5, 8, 9))
    q[..., 3:7], target[..., 3:7] = quat_normalize(q[..., 3:7]), quat_normalize(target[..., 3:7])
    q[0, 1, 3:7] = target[0, 0, 3:7]  # no rotation at all
    n_steps, error = np.array([8, 3, 1, 8, 5]), np.full((5, 8, 8), np.nan)
    fill_errors(q, target, n_steps, 0.05, error)
    position = (q[:, 1:, :3] - target[..., :3]) / 0.05
    turned = quat_boxminus(q[:, 1:, 3:7], target[..., 3:7])
    expected = np.concatenate([position, turned, q[:, 1:, 7:] - target[..., 7:]], axis=-1)
    expected[np.arange(8) >= n_steps[:, None]] = 0.0
    np.testing.assert_allclose(error, expected, rtol=1e-12, atol=1e-15)
