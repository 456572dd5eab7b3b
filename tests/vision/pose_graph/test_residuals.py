"""A scene's rows and residuals: what is merged and left out, outliers, noise, and poses that do not pass."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace

import numpy as np
import pytest

from tests.vision.sights import filmed_tumble, sights, tumble, wall
from tossid.objects import ObjectModel
from tossid.settings.tracking import TrackSettings
from tossid.types import Detection
from tossid.vision.cameras.rig import default_rig
from tossid.vision.pose_graph.gating import Gate, gate_steps
from tossid.vision.pose_graph.reprojection import reproject
from tossid.vision.pose_graph.robust import SolvedScene, solve_scene
from tossid.vision.pose_graph.scene import observe, time_steps
from tossid.vision.pose_graph.track import track_scene
from tossid.vision.setup.layout import Body, Remap, Squash, layout_of


def _solved(detections: list[Detection], model: ObjectModel) -> SolvedScene:
    scene = observe(detections, default_rig(), layout_of(model), dropped=Counter())
    return solve_scene(scene, np.zeros(3, dtype=bool), settings=TrackSettings())


def _moving(solved: SolvedScene) -> int:
    return next(b for b, body in enumerate(solved.scene.bodies) if not body.is_static)


# ---------------------------------------------------------------- rows


def test_a_static_camera_sees_a_static_tag_once() -> None:
    """Merged sightings give what all of them would, and a tag that did move is not merged."""
    detections, cameras, layout = wall(np.random.default_rng(6), noise=0.3)
    first = [replace(d, t=k / 10) for k in range(20) for d in detections[:4]]
    rng = np.random.default_rng(7)
    first = [replace(d, corners=d.corners + 0.3 * rng.normal(size=(4, 2))) for d in first]
    static = replace(layout, bodies=(layout.bodies[0], Body("rig", True)))
    scene = observe(first, cameras, static, dropped=Counter())
    np.testing.assert_array_equal(scene.count, [20] * 4)
    mean = np.mean([d.corners for d in first if d.tag_id == 2], axis=0)
    np.testing.assert_allclose(scene.pixels[2], mean, atol=1e-9)
    bumped = [replace(d, corners=d.corners + 40 * (d.t > 1.0) * (d.tag_id == 3)) for d in first]
    assert len(observe(bumped, cameras, static, dropped=Counter()).step) == 3 + 20


def test_what_is_left_out_is_counted(tagged: ObjectModel) -> None:
    cameras = default_rig()
    detections, _ = filmed_tumble(cameras, tagged, np.random.default_rng(8), n=40)
    more = [*detections, replace(detections[0], corners=detections[0].corners + 30), replace(detections[1], tag_id=77)]
    more.append(replace(detections[2], corners=np.full((4, 2), np.nan)))
    out, away = (Counter(d.tag_id for d in detections if d.camera == "cam1" or k).most_common(2)[k][0] for k in (0, 1))
    layout = replace(
        layout_of(tagged),
        squashes=(Squash(frozenset({out}), None, "cam1"),),
        remaps=(Remap(away, 55, 0.0, 0.1),),
        max_hamming=1,
    )
    more.append(replace(detections[3], t=9.0, hamming=2))
    dropped = track_scene(more, cameras, layout).report.dropped_tags
    assert dropped["squashed"] == sum(d.tag_id == out and d.camera == "cam1" for d in more)
    assert dropped["id on no body"] == sum(d.tag_id == away and d.t <= 0.1 for d in more) + 1
    assert dropped["id seen twice in a frame"] >= 2
    assert dropped["too many corrected bits"] == 1
    assert "corners or covariance not finite" not in dropped  # it was one of two, neither to be accepted


def test_frames_within_half_a_period_are_one_step() -> None:
    """Two cameras of 100 Hz, 2 ms apart, and one of 50 Hz between them."""
    t = np.concatenate([np.arange(6) / 100, np.arange(6) / 100 + 0.002, np.arange(3) / 50 + 0.001])
    order = np.argsort(t, kind="stable")
    step, times = time_steps(t[order], np.repeat([0, 1, 2], [6, 6, 3])[order])
    np.testing.assert_allclose(times, np.arange(6) / 100)
    np.testing.assert_array_equal(np.bincount(step), [3, 2, 3, 2, 3, 2])


def test_a_frame_that_is_late_within_its_step_is_used_at_its_own_time(tagged: ObjectModel) -> None:
    """A camera's frames 1.5 ms after the others', at up to 2 m/s and 5 rad/s: still the noise and no more."""
    rng, cameras = np.random.default_rng(2), default_rig()
    t, q = tumble(60 * 20, rng, rate_hz=148 * 20)
    detections = []
    for c in range(3):
        late = slice(4 if c == 1 else 0, -20, 20)
        detections += sights(cameras[c : c + 1], tagged, t[late], q[late], rng)
    solved = _solved(detections, tagged)
    assert np.abs(solved.scene.delay).max() == pytest.approx(4 / 148 / 20)
    assert np.sqrt(np.mean(solved.errors.pixels[solved.used] ** 2)) < 1.15 * 0.1 * 2**0.5


# ---------------------------------------------------------------- outliers and noise


def test_one_shifted_tag_is_the_only_outlier(tagged: ObjectModel) -> None:
    detections, _ = filmed_tumble(default_rig(), tagged, np.random.default_rng(0), n=40)
    wrong = len(detections) // 2
    detections[wrong] = replace(detections[wrong], corners=detections[wrong].corners + np.array([25.0, -10.0]))
    solved = _solved(detections, tagged)
    (out,) = np.flatnonzero(~solved.used)
    assert solved.outliers == 1
    assert solved.scene.tag[out] == [tag.id for tag in solved.scene.tags].index(detections[wrong].tag_id)
    assert not solved.suspects


def test_covariances_follow_the_residuals_noise(tagged: ObjectModel) -> None:
    """Detections that understate their noise threefold give the same poses, as sure as honest ones."""
    detections, _ = filmed_tumble(default_rig(), tagged, np.random.default_rng(1), n=60)
    honest = _solved(detections, tagged)
    solved = _solved([replace(d, corner_cov=d.corner_cov / 9) for d in detections], tagged)
    assert (honest.scale, solved.scale) == (pytest.approx(1.0, rel=0.05), pytest.approx(3.0, rel=0.05))
    ratio = solved.solution.world_cov[_moving(solved)] / honest.solution.world_cov[_moving(honest)]
    assert np.median(ratio[:, range(6), range(6)]) == pytest.approx(1.0, abs=0.15)


def test_uncertain_poses_and_jumps_do_not_pass_and_limits_follow_the_noise(tagged: ObjectModel) -> None:
    """Limits far below a recording's own noise reject nothing."""
    detections, _ = filmed_tumble(default_rig(), tagged, np.random.default_rng(0), n=30)
    solved = _solved(detections, tagged)
    scene, b = solved.scene, _moving(solved)

    def gated(settings: TrackSettings) -> Gate:
        errors = reproject(scene, solved.solution.state)
        return gate_steps(scene, solved.solution, errors, solved.used, np.ones(len(scene.t), bool), [b], settings)

    assert gated(TrackSettings()).accepted.all()
    assert gated(TrackSettings(max_rms=1e-6, max_sigma=1e-9, max_angle_sigma=1e-9)).accepted.all()
    solved.solution.world_cov[b][10] *= 1e6
    solved.solution.state.world[b][20, 0, 3] += 1.0
    gate = gated(TrackSettings(max_rms=1e9))
    assert np.flatnonzero(gate.rejected["too uncertain"]).tolist() == [10]
    assert np.flatnonzero(gate.rejected["jump"]).tolist() == [20]
    assert gate.reasons == {"too uncertain": 1, "jump": 1}
