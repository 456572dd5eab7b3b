"""Gating: which limit rejects a pose, and that limits bend with the recording."""

from __future__ import annotations

from collections import Counter

import numpy as np
import pytest

from tests.vision.sights import filmed_tumble
from tossid.objects import ObjectModel
from tossid.settings.tracking import TrackSettings
from tossid.vision.cameras.rig import default_rig
from tossid.vision.pose_graph.gating import Gate, gate_steps
from tossid.vision.pose_graph.reprojection import reproject
from tossid.vision.pose_graph.robust import SolvedScene, solve_scene
from tossid.vision.pose_graph.scene import observe
from tossid.vision.setup.layout import layout_of

SETTINGS = TrackSettings()


@pytest.fixture(scope="module")
def solved(tagged: ObjectModel) -> SolvedScene:
    cameras = default_rig()
    detections, _ = filmed_tumble(cameras, tagged, np.random.default_rng(0), n=30)
    scene = observe(detections, cameras, layout_of(tagged), dropped=Counter())
    return solve_scene(scene, {}, settings=SETTINGS)


def _gate(solved: SolvedScene, settings: TrackSettings = SETTINGS) -> Gate:
    scene = solved.scene
    b = next(i for i, body in enumerate(scene.bodies) if not body.is_static)
    errors = reproject(scene, solved.solution.state)
    return gate_steps(scene, solved.solution, errors, solved.used, np.ones(len(scene.t), dtype=bool), b, settings)


def test_a_step_counts_for_the_first_reason_alone() -> None:
    gate = Gate(np.array([True, True, False]))
    gate.reject(np.array([True, False, True]), "first")
    gate.reject(np.array([True, True, True]), "second")
    assert gate.reasons == {"first": 1, "second": 1}
    assert not gate.accepted.any()
    np.testing.assert_array_equal(gate.rejected["second"], [False, True, False])


def test_good_poses_pass(solved: SolvedScene) -> None:
    assert _gate(solved).accepted.all()


def test_limits_that_are_too_tight_are_widened_to_the_recordings_own_uncertainty(solved: SolvedScene) -> None:
    """Limits far below the noise reject nothing. The noise follows from the covariances of the corners."""
    assert _gate(solved, TrackSettings(max_rms=1e-6, max_sigma=1e-9, max_angle_sigma=1e-9)).accepted.all()


def test_an_uncertain_pose_and_a_jump_are_rejected(solved: SolvedScene) -> None:
    b = next(i for i, body in enumerate(solved.scene.bodies) if not body.is_static)
    world, cov = solved.solution.state.world[b], solved.solution.world_cov[b]
    kept = world.copy(), cov.copy()
    try:
        cov[10] *= 1e6
        world[20, 0, 3] += 1.0
        gate = _gate(solved, TrackSettings(max_rms=1e9))
    finally:
        world[:], cov[:] = kept
    assert np.flatnonzero(gate.rejected["too uncertain"]).tolist() == [10]
    assert np.flatnonzero(gate.rejected["jump"]).tolist() == [20]
