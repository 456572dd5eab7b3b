"""Gravity's direction and the ground from motion alone, against truth."""

from __future__ import annotations

import numpy as np
import pytest

from tests.motion.handling import Handling
from tossid.errors import InputError
from tossid.motion.ground_plane import Ground, _clustered, _plane, find_ground
from tossid.motion.segmentation import segment
from tossid.objects import ObjectModel, corner_positions
from tossid.rotations import quat_exp, quat_mul, quat_to_matrix
from tossid.settings.segmentation import GroundSettings
from tossid.types import PoseTrack


def _elsewhere(track: PoseTrack, turn: np.ndarray, shift: np.ndarray) -> PoseTrack:
    """A track as a turned and shifted world has it."""
    q = track.q.copy()
    q[:, :3] = q[:, :3] @ quat_to_matrix(turn).T + shift
    q[:, 3:7] = quat_mul(np.broadcast_to(turn, (len(q), 4)), q[:, 3:7])
    return PoseTrack(track.name, track.t, q, track.q_cov)


@pytest.mark.parametrize("which", ["cube", "elbow"])
def test_a_tilted_world_is_levelled(which: str, request: pytest.FixtureRequest) -> None:
    model: ObjectModel = request.getfixturevalue(which)
    rng = np.random.default_rng(1)
    made = Handling(model, rng).recording(90.0)
    for size in (0.02, 1.5):
        turn, shift = quat_exp(size * rng.normal(size=3)), rng.normal(size=3)
        track = _elsewhere(made.tracked(rng), turn, shift)
        ground = find_ground(track, model)
        normal = quat_to_matrix(turn)[:, 2]
        assert np.linalg.norm(np.cross(normal, ground.up)) < 5e-5
        assert ground.up @ normal > 0
        assert abs(ground.height - normal @ shift) < 5 * np.sqrt(ground.cov[0, 0]) < 2e-4
        assert np.abs(ground.slope).max() < 1e-6
        assert 0.0002 < ground.gravity_sigma < 0.003
        level = ground.levelled(track)
        found, _ = segment(level, model)
        assert len(found) == len(made.release)
        assert min(corner_positions(model, toss.q[-1:])[..., 2].min() for toss in found) > -0.001
        assert level.q_cov is not None


def test_a_ground_that_slopes_is_said_and_gravity_stays_up(cube: ObjectModel) -> None:
    rng, slope = np.random.default_rng(2), np.deg2rad(2.0)
    gravity = (9.81 * np.sin(slope), 0.0, -9.81 * np.cos(slope))
    made = Handling(cube, rng, kinds={"toss": 3, "put down gently": 1}, gravity=gravity).recording(60.0)
    ground = find_ground(made.tracked(rng), cube)
    assert np.linalg.norm(np.cross(ground.up, -np.array(gravity) / 9.81)) < 5 * ground.gravity_sigma
    assert np.linalg.norm(ground.slope) == pytest.approx(np.tan(slope), abs=5 * ground.gravity_sigma)
    assert ground.tilt == pytest.approx(slope, abs=5 * ground.gravity_sigma)


def test_without_flights_the_ground_is_level(cube: ObjectModel) -> None:
    rng = np.random.default_rng(3)
    made = Handling(cube, rng, kinds={"put down gently": 1}).recording(30.0)
    turn = quat_exp(np.array([0.02, -0.03, 0.0]))
    ground = find_ground(_elsewhere(made.tracked(rng), turn, np.array([0.0, 0.0, 0.05])), cube)
    assert not ground.gravity_sigma < 0.01  # a hand's acceleration is now and then gravity's
    assert np.linalg.norm(np.cross(quat_to_matrix(turn)[:, 2], ground.up)) < 5e-4


def test_too_few_rests_are_said(cube: ObjectModel) -> None:
    t = np.arange(100) / 148
    q = np.zeros((100, 7))
    q[:, 2], q[:, 3] = 0.0524, 1.0
    with pytest.raises(InputError, match="1 places"):
        find_ground(PoseTrack("still", t, q), cube)


def test_covariances_count_rests_not_corners() -> None:
    """What the corners of a rest have in common is an error of that rest; what is held up is left out."""
    rng, errors = np.random.default_rng(4), []
    for _ in range(60):
        truth = np.array([0.004, 0.01, -0.02])
        rests = []
        for k in range(60):
            at = rng.uniform(-0.4, 0.4, 2) + 0.05 * np.array([[1, 1], [1, -1], [-1, -1], [-1, 1]])
            z = truth[0] + at @ truth[1:] + 1e-4 * rng.normal() + 3e-5 * rng.normal(size=4)
            rests.append(np.column_stack([at, z + (0.08 if k % 8 == 0 else 0.0)]))
        plane, kept, _ = _plane(rests, GroundSettings().least_scatter)
        np.testing.assert_array_equal(kept, np.arange(60) % 8 != 0)
        error = plane - truth
        cov = _clustered([rest for rest, good in zip(rests, kept, strict=True) if good], plane)
        errors.append(error @ np.linalg.solve(cov, error) / 3)
    assert 0.7 < np.mean(errors) < 1.5


def test_turning_is_by_the_shortest_way() -> None:
    for up in ([0.0, 0.0, 1.0], [0.0, 0.0, -1.0], [0.6, 0.0, 0.8], [0.0, 1.0, 0.0]):
        ground = Ground(np.array(up), 0.001, 0.0, np.zeros(2), np.zeros((3, 3)), 0.0, 0, 0, 0)
        np.testing.assert_allclose(quat_to_matrix(ground.turn) @ up, [0, 0, 1], atol=1e-12)


def test_short_blocks_give_the_same_ground(cube: ObjectModel) -> None:
    track = Handling(cube, np.random.default_rng(7)).recording(60.0).tracked(np.random.default_rng(8))
    whole = find_ground(track, cube)
    parts = find_ground(track, cube, settings=GroundSettings(block_frames=1500))
    assert (parts.n_rests, parts.n_left_out, parts.n_falling) == (whole.n_rests, whole.n_left_out, whole.n_falling)
    assert parts.height == pytest.approx(whole.height, abs=1e-7)
    np.testing.assert_allclose(parts.up, whole.up, atol=1e-7)
