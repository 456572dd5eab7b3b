"""A scene that was not solved keeps its poses and has no covariances."""

from __future__ import annotations

import numpy as np

from tossid.vision.pose_graph.initial import State
from tossid.vision.pose_graph.solution import unsolved


def test_poses_stay_and_covariances_are_unknown() -> None:
    eye = np.eye(4)
    state = State(np.stack([eye, eye]), np.stack([eye] * 3), [np.stack([eye] * 5), eye[None]], np.zeros((3, 3)), [1])
    found = unsolved(state, np.array([0.0, 0.02]))
    assert found.camera_cov.shape == (2, 6, 6)
    assert found.tag_cov.shape == (3, 6, 6)
    assert [cov.shape for cov in found.world_cov] == [(5, 6, 6), (1, 6, 6)]
    assert all(np.isnan(cov).all() for cov in (found.camera_cov, found.tag_cov, *found.world_cov))
    np.testing.assert_array_equal(found.clock, [0.0, 0.02])
    assert not found.clock_sigma.any()
    found.state.world[0][0, 0, 3] = 1.0
    assert state.world[0][0, 0, 3] == 0.0  # a copy
