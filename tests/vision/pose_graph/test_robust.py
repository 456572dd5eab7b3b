"""Residuals and what follows from them: outliers, noise, limits of a pose, and reports."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace

import numpy as np
import pytest

from tests.vision.sights import filmed_tumble, seen, tumble
from tossid.objects import ObjectModel
from tossid.rotations import transform
from tossid.settings.tracking import TrackSettings
from tossid.types import Detection
from tossid.vision.cameras.rig import default_rig
from tossid.vision.pose_graph.gating import Gate, gate_steps
from tossid.vision.pose_graph.report import frame_errors
from tossid.vision.pose_graph.reprojection import printed_corners, reproject
from tossid.vision.pose_graph.robust import SolvedScene, solve_scene
from tossid.vision.pose_graph.scene import Scene, corner_growth, observe
from tossid.vision.pose_graph.state import State, given
from tossid.vision.pose_graph.track import track_scene
from tossid.vision.setup.layout import SQUARE, layout_of


def _solved(detections: list[Detection], model: ObjectModel) -> SolvedScene:
    scene = observe(detections, default_rig(), layout_of(model), dropped=Counter())
    return solve_scene(scene, np.zeros(3, dtype=bool), settings=TrackSettings())


def test_one_shifted_tag_is_the_only_outlier(tagged: ObjectModel) -> None:
    detections, _ = filmed_tumble(default_rig(), tagged, np.random.default_rng(0), n=40)
    wrong = len(detections) // 2
    shifted = list(detections)
    shifted[wrong] = replace(shifted[wrong], corners=shifted[wrong].corners + np.array([25.0, -10.0]))
    solved = _solved(shifted, tagged)
    out = np.flatnonzero(~solved.used)
    assert solved.outliers == len(out) == 1
    assert solved.scene.tag[out[0]] == [tag.id for tag in solved.scene.tags].index(shifted[wrong].tag_id)
    assert not solved.suspects


@pytest.mark.parametrize("understated", [1.0, 3.0])
def test_covariances_follow_the_residuals_noise(tagged: ObjectModel, understated: float) -> None:
    detections, _ = filmed_tumble(default_rig(), tagged, np.random.default_rng(1), n=60)
    honest = _solved(detections, tagged)
    solved = _solved([replace(d, corner_cov=d.corner_cov / understated**2) for d in detections], tagged)
    assert solved.scale == pytest.approx(understated, rel=0.05)
    moving = next(b for b, body in enumerate(solved.scene.bodies) if not body.is_static)
    ratio = solved.solution.world_cov[moving] / honest.solution.world_cov[moving]
    assert np.median(ratio[:, range(6), range(6)]) == pytest.approx(1.0, abs=0.15)


def test_a_frame_that_is_late_within_its_step_is_used_at_its_own_time(tagged: ObjectModel) -> None:
    """A camera's frames 1.5 ms after the others', at up to 2 m/s and 5 rad/s: still the noise and no more."""
    rng, cameras = np.random.default_rng(2), default_rig()
    t, q = tumble(60 * 20, rng, rate_hz=148 * 20)
    detections = []
    for i in range(0, len(t) - 20, 20):
        for c, camera in enumerate(cameras):
            k = i + (4 if c == 1 else 0)
            detections += seen([camera], tagged, t[k], q[k], rng, 0.1)
    solved = _solved(detections, tagged)
    assert np.abs(solved.scene.delay).max() == pytest.approx(4 / 148 / 20)
    assert np.sqrt(np.mean(solved.errors.pixels[solved.used] ** 2)) < 1.15 * 0.1 * 2**0.5


SIGMA, SPREAD = 0.1, 0.8


def _true(model: ObjectModel, *, spread: float = 0.0) -> tuple[Scene, State]:
    cameras = default_rig()
    detections, q = filmed_tumble(cameras, model, np.random.default_rng(0), n=80, sigma=SIGMA)
    detections = [replace(d, corners=d.corners + spread * corner_growth(d.corners[None])[0]) for d in detections]
    scene = observe(detections, cameras, layout_of(model), dropped=Counter())
    state = given(scene)
    b = next(i for i, body in enumerate(scene.bodies) if not body.is_static)
    state.world[b][:] = transform(q[:, :3], q[:, 3:7])
    return scene, state


def test_true_poses_leave_the_noise(tagged: ObjectModel) -> None:
    scene, state = _true(tagged)
    errors = reproject(scene, state)
    assert np.sqrt(np.mean(errors.pixels**2)) == pytest.approx(SIGMA * 2**0.5, rel=0.03)
    assert np.sqrt(np.mean(errors.whitened**2)) == pytest.approx(1.0, rel=0.03)
    np.testing.assert_allclose(errors.expected_pixels, SIGMA * 2**0.5, rtol=1e-6)
    np.testing.assert_array_equal(errors.pixels, errors.raw_pixels)


def test_a_spread_of_edges_is_estimated_and_subtracted(tagged: ObjectModel) -> None:
    scene, state = _true(tagged, spread=SPREAD)
    errors = reproject(scene, state, spread_sigma=SPREAD)
    assert np.median(errors.spread) == pytest.approx(SPREAD, rel=0.02)
    assert np.sqrt(np.mean(errors.pixels**2)) < 1.05 * SIGMA * 2**0.5 < np.sqrt(np.mean(errors.raw_pixels**2))


def test_an_unknown_pose_has_no_reprojection(tagged: ObjectModel) -> None:
    scene, state = _true(tagged)
    state.tag[0] = np.nan
    np.testing.assert_array_equal(np.isnan(reproject(scene, state).pixels), scene.tag == 0)


def test_prints_stretch_and_twist_corners() -> None:
    np.testing.assert_array_equal(printed_corners(np.zeros(3)), SQUARE)
    corners = printed_corners(np.array([0.02, -0.01, 0.03]))
    np.testing.assert_allclose(corners[2], [1.02, 0.99, 0.03])
    np.testing.assert_allclose(corners[3], [-1.02, 0.99, -0.03])


SETTINGS = TrackSettings()


@pytest.fixture(scope="module")
def solved(tagged: ObjectModel) -> SolvedScene:
    cameras = default_rig()
    detections, _ = filmed_tumble(cameras, tagged, np.random.default_rng(0), n=30)
    scene = observe(detections, cameras, layout_of(tagged), dropped=Counter())
    return solve_scene(scene, np.zeros(3, dtype=bool), settings=SETTINGS)


def _gate(solved: SolvedScene, settings: TrackSettings = SETTINGS) -> Gate:
    scene = solved.scene
    b = next(i for i, body in enumerate(scene.bodies) if not body.is_static)
    errors = reproject(scene, solved.solution.state)
    return gate_steps(scene, solved.solution, errors, solved.used, np.ones(len(scene.t), dtype=bool), [b], settings)


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


def test_a_frames_rms_is_over_its_tags(tagged: ObjectModel) -> None:
    detections, _ = filmed_tumble(default_rig(), tagged, np.random.default_rng(0), n=5)
    scene = observe(detections, default_rig(), layout_of(tagged), dropped=Counter())
    errors = replace(reproject(scene, given(scene)), pixels=np.arange(1.0, len(scene.step) + 1))
    frames = frame_errors(scene, errors, np.ones(len(scene.step), dtype=bool))
    assert frames.tags.sum() == len(scene.step)
    for t, c, rms, tags in zip(frames.t, frames.camera, frames.rms, frames.tags, strict=True):
        rows = (scene.t[scene.step] + scene.delay == t) & (scene.camera == c)
        assert tags == rows.sum()
        assert rms == np.sqrt(np.mean(errors.pixels[rows] ** 2))


def test_a_calibrated_camera_has_a_pose_and_a_covariance(tagged: ObjectModel) -> None:
    true = default_rig()
    detections, _ = filmed_tumble(true, tagged, np.random.default_rng(1), n=60)
    cameras = (*true[:2], replace(true[2], T_rig_cam=None))
    tracked = track_scene(detections, cameras, layout_of(tagged))
    first, _, found = tracked.cameras
    assert first.T_rig_cam_cov is None  # exactly given
    assert found.T_rig_cam is not None
    assert found.T_rig_cam_cov is not None
    change = tracked.report.cameras[found.name]
    assert (change.distance, change.angle) == (None, None)  # none was given
    assert np.linalg.norm(found.T_rig_cam[:3, 3] - true[2].T_rig_cam[:3, 3]) < 5 * change.sigma
    assert set(tracked.report.cameras) == {found.name}
    assert tracked.report.n_steps == tracked.report.n_poses + sum(tracked.report.dropped_steps.values())
