"""Differences of states, and states that differ by them."""

from __future__ import annotations

import numpy as np

from tossid.diagnosis.likelihood.states import difference, moved_pose, moved_state, of_state


def test_a_moved_pose_differs_by_what_it_was_moved_by() -> None:
    rng = np.random.default_rng(0)
    q, by = rng.normal(size=(50, 7 + 1)), 0.5 * rng.normal(size=(50, 7))
    q[:, 3:7] /= np.linalg.norm(q[:, 3:7], axis=1, keepdims=True)
    np.testing.assert_allclose(difference(moved_pose(q, by), q), by, atol=1e-12)


def test_a_moved_state_has_its_velocity_moved_too() -> None:
    rng = np.random.default_rng(1)
    q, v, by = rng.normal(size=(20, 7)), rng.normal(size=(20, 6)), 0.3 * rng.normal(size=(20, 12))
    q[:, 3:7] /= np.linalg.norm(q[:, 3:7], axis=1, keepdims=True)
    moved_q, moved_v = moved_state(q, v, by)
    np.testing.assert_allclose(difference(moved_q, q), by[:, :6], atol=1e-12)
    np.testing.assert_allclose(moved_v - v, by[:, 6:], atol=1e-12)


def test_joints_are_counted_as_rotations() -> None:
    np.testing.assert_array_equal(of_state((1.0, 2.0, 3.0, 4.0), 7), [1, 1, 1, 2, 2, 2, 2, 3, 3, 3, 4, 4, 4, 4])
