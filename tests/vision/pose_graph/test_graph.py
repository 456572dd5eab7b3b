"""The pose graph against truth, and against TagSLAM's own poses of its published recordings."""

from __future__ import annotations

import csv
from collections import Counter
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.vision.pose_graph.walls import wall
from tests.vision.sights import filmed_tumble, nees
from tossid.errors import InputError
from tossid.objects import ObjectModel
from tossid.rotations import geodesic_angle, matrix_to_quat, transform, transform_inv, xyzw_to_wxyz
from tossid.settings.tracking import StreamSettings, TrackSettings
from tossid.types import Detection
from tossid.vision.cameras.camera import Camera
from tossid.vision.cameras.rig import default_rig
from tossid.vision.pose_graph.graph import solve
from tossid.vision.pose_graph.graph_builder import Problem
from tossid.vision.pose_graph.initial import initialise
from tossid.vision.pose_graph.scene import observe
from tossid.vision.pose_graph.state import priors
from tossid.vision.pose_graph.track import Tracked, track_scene
from tossid.vision.recordings.bag_contents import read_bag_detections
from tossid.vision.setup.calibration import read_cameras
from tossid.vision.setup.layout import Body, BodyTag, Measurement, TagLayout, layout_of
from tossid.vision.setup.tagslam import read_tagslam

EVERYTHING = TrackSettings(max_sigma=np.inf, max_angle_sigma=np.inf)


def _apart(A: np.ndarray, B: np.ndarray) -> tuple[float, float]:
    """Distance [mm] and angle [degrees] of two poses."""
    turn = geodesic_angle(matrix_to_quat(A[:3, :3]), matrix_to_quat(B[:3, :3]))
    return 1e3 * float(np.linalg.norm(A[:3, 3] - B[:3, 3])), float(np.rad2deg(turn))


def _without(layout: TagLayout, *, but: int | None = None) -> TagLayout:
    """The layout with the poses of its moving bodies' tags unknown, but for one."""
    bodies = []
    for body in layout.bodies:
        tags = [tag if body.is_static or tag.id == but else BodyTag(tag.id, tag.size, None) for tag in body.tags]
        bodies.append(replace(body, tags=tuple(tags)))
    return replace(layout, bodies=tuple(bodies))


def test_a_cubes_tags_are_calibrated(tagged: ObjectModel):
    """Poses of five tags unknown, no two of the opposite ones ever seen together by one camera: within 0.2 mm."""
    cameras = default_rig()
    detections, q = filmed_tumble(cameras, tagged, np.random.default_rng(0), n=250)
    tracked = track_scene(detections, cameras, _without(layout_of(tagged), but=0))
    found = {tag.id: tag for tag in tracked.layout.bodies[-1].tags}
    errors = []
    for tag in tagged.tags[1:]:
        T = found[tag.id].T_body_tag
        distance, angle = _apart(T, tag.T_body_tag)
        assert distance < 0.2
        assert angle < 0.2
        errors.append((T[:3, :3].T @ (T[:3, 3] - tag.T_body_tag[:3, 3])) / found[tag.id].position_noise)
    assert 0.3 < np.mean(np.square(errors)) < 3.0
    track = tracked.tracks["cube"]
    assert len(track.t) == 250
    assert np.mean(nees(track, q)) == pytest.approx(1.0, abs=0.25)
    assert set(tracked.report.tags) == {1, 2, 3, 4, 5}


def test_without_any_known_tag_one_of_them_is_the_frame(tagged: ObjectModel):
    cameras = default_rig()
    detections, _ = filmed_tumble(cameras, tagged, np.random.default_rng(1), n=120)
    tracked = track_scene(detections, cameras, _without(layout_of(tagged)))
    T = {tag.id: tag.T_body_tag for tag in tracked.layout.bodies[-1].tags}
    (frame,) = [tag_id for tag_id, pose in T.items() if np.array_equal(pose, np.eye(4))]
    true = {tag.id: tag.T_body_tag for tag in tagged.tags}
    for tag_id, pose in T.items():
        assert _apart(pose, transform_inv(true[frame]) @ true[tag_id])[0] < 0.3


def test_cameras_are_calibrated_without_a_common_view(tagged: ObjectModel):
    """The first and the last camera never see the cube at the same time."""
    cameras = default_rig(n_cameras=3)
    detections, _ = filmed_tumble(cameras, tagged, np.random.default_rng(2), n=200)
    apart = [d for d in detections if not (d.camera == "cam0" and d.t > 0.7) and not (d.camera == "cam2" and d.t < 0.7)]
    unknown = [cameras[0], *(replace(camera, T_rig_cam=None) for camera in cameras[1:])]
    tracked = track_scene(apart, unknown, layout_of(tagged))
    for found, true in zip(tracked.cameras, cameras, strict=True):
        distance, angle = _apart(found.T_rig_cam, true.T_rig_cam)
        assert distance < 2.0
        assert angle < 0.1
    assert set(tracked.report.cameras) == {"cam1", "cam2"}
    assert tracked.report.unplaced == []


def test_the_rig_may_be_the_moving_body(tagged: ObjectModel):
    """The same sightings, with the cube standing still and the cameras' rig around it moving."""
    cameras = default_rig()
    detections, q = filmed_tumble(cameras, tagged, np.random.default_rng(3), n=80)
    tags = layout_of(tagged).bodies[-1].tags
    layout = TagLayout((Body("rig", False), Body("cube", True, np.eye(4), tags=tags)))
    moving = [replace(camera, T_world_rig=None) for camera in cameras]
    tracked = track_scene(detections, moving, layout, settings=EVERYTHING)
    track = tracked.tracks["rig"]
    T_world_rig = transform(track.q[:, :3], track.q[:, 3:7])
    expected = transform_inv(transform(q[:, :3], q[:, 3:7]))
    assert len(track.t) == 80
    assert np.median([_apart(A, B)[0] for A, B in zip(T_world_rig, expected, strict=True)]) < 2.0


def test_windows_give_what_one_batch_gives(tagged: ObjectModel):
    cameras = default_rig()
    detections, _ = filmed_tumble(cameras, tagged, np.random.default_rng(4), n=150)
    layout = _without(layout_of(tagged), but=0)
    scene = observe(detections, cameras, layout, dropped=Counter())
    state, used = initialise(scene), np.ones(len(detections), dtype=bool)
    problem = Problem(scene, used, priors(scene), covariances=True)
    whole = solve(problem, state)
    parts = solve(replace(problem, settings=TrackSettings(stream=StreamSettings(window=60))), state)
    distance = np.linalg.norm(whole.state.world[-1][:, :3, 3] - parts.state.world[-1][:, :3, 3], axis=1)
    sigma = np.sqrt(np.diagonal(whole.world_cov[-1], axis1=1, axis2=2)[:, 3:].max(axis=1))
    assert (distance < sigma).all()
    ratio = np.diagonal(parts.world_cov[-1], axis1=1, axis2=2) / np.diagonal(whole.world_cov[-1], axis1=1, axis2=2)
    assert 0.7 < np.median(ratio) < 1.5
    # what is static is as sure as the sample made it, which is of fewer steps; no window adds to that
    known = np.isfinite(whole.tag_cov).all(axis=(1, 2)) & whole.tag_cov.any(axis=(1, 2))
    assert known.sum() == len(layout.bodies[-1].tags) - 1
    ratio = np.diagonal(parts.tag_cov[known], axis1=1, axis2=2) / np.diagonal(whole.tag_cov[known], axis1=1, axis2=2)
    assert (ratio > 1).all()
    assert np.median(ratio) < 4


def test_measured_lengths_weigh():
    detections, cameras, layout = wall(np.random.default_rng(5), noise=0.5)
    # said to be 3 mm further apart than it looks, very surely
    measurements = (Measurement("far", ((0, 0), (3, 0)), 1.003 * np.hypot(1.0, 0.8), 1e-5),)
    free, held = (
        track_scene(detections, cameras, replace(layout, measurements=m), settings=EVERYTHING)
        for m in ((), measurements)
    )

    def far(tracked: Tracked) -> float:
        T = {tag.id: tag.T_body_tag for tag in tracked.layout.bodies[0].tags}
        corner = np.array([-0.1, -0.1, 0, 1])
        return float(np.linalg.norm((T[0] @ corner - T[3] @ corner)[:3]))

    assert far(free) == pytest.approx(np.hypot(1.0, 0.8), abs=0.004)
    assert far(held) == pytest.approx(1.003 * np.hypot(1.0, 0.8), abs=1e-4)
    level = (Measurement("level", ((1, None),), 3.01, 1e-6, np.array([0.0, 0, 1])),)
    tracked = track_scene(detections, cameras, replace(layout, measurements=level), settings=EVERYTHING)
    assert tracked.layout.bodies[0].tags[1].T_body_tag[2, 3] == pytest.approx(3.01, abs=1e-4)


def test_a_scene_where_nothing_moves_is_only_calibrated():
    detections, cameras, layout = wall(np.random.default_rng(10), noise=0.05)
    still = [replace(d, t=d.t + k) for k in range(3) for d in detections[20:24]]
    tracked = track_scene(still, cameras, replace(layout, bodies=(layout.bodies[0], Body("rig", True))))
    assert tracked.tracks == {}
    np.testing.assert_allclose(tracked.layout.bodies[0].tags[3].T_body_tag[:3, 3], [0.5, 0.4, 3.0], atol=0.05)
    assert tracked.layout.bodies[1].T_map_body is not None


def test_what_cannot_be_placed_is_said(tagged: ObjectModel):
    cameras = default_rig()
    detections, _ = filmed_tumble(cameras, tagged, np.random.default_rng(9), n=5)
    lost = [replace(camera, T_rig_cam=None) for camera in cameras]
    with pytest.raises(InputError, match="no camera can be placed"):
        track_scene(detections, lost, layout_of(tagged))
    with pytest.raises(InputError, match="'rig', which is no body"):
        track_scene(detections, cameras, TagLayout((Body("lab", True, np.eye(4)),)))
    other = replace(layout_of(tagged), default_body="rig")
    with pytest.raises(InputError, match="no default_tag_size"):
        track_scene([replace(d, tag_id=300) for d in detections], cameras, other)


def _recording(shared_data: Path, test: int) -> tuple[list[Detection], tuple[Camera, ...], TagLayout]:
    folder = shared_data / "tagslam_test" / f"test_{test}"
    layout = read_tagslam(folder / "tagslam.yaml")
    cameras = read_cameras(folder, layout=layout)
    return list(read_bag_detections(folder, cameras, sigma=1.0).detections), cameras, layout


@pytest.mark.parametrize(
    ("test", "body", "distance", "angle"),
    [(16, "cam_rig", 0.5, 0.01), (17, "cam_rig", 0.5, 0.01), (4, "wand", 1.0, 0.03), (23, "tag_board", 1.0, 0.03)],
)
def test_poses_are_tagslams(shared_data: Path, test: int, body: str, distance: float, angle: float):
    """Every pose that TagSLAM has of its own recordings, from its own set-up and bag."""
    tracked = track_scene(*_recording(shared_data, test), settings=EVERYTHING)
    with (shared_data / "tagslam_test" / f"test_{test}" / "reference_poses.csv").open() as stream:
        rows = list(csv.DictReader(stream))
    track, errors = tracked.tracks[body], []
    for row in rows:
        i = int(np.argmin(np.abs(track.t - int(row["t_ns"]) * 1e-9)))
        assert abs(track.t[i] - int(row["t_ns"]) * 1e-9) < 1e-5
        quat = xyzw_to_wxyz([float(row[f"q{k}"]) for k in "xyzw"])
        expected = transform(np.array([float(row[k]) for k in "xyz"]), quat)
        errors.append(_apart(transform(track.q[i, :3], track.q[i, 3:7]), expected))
    assert np.median(errors, axis=0)[0] < distance
    assert np.median(errors, axis=0)[1] < angle


def test_the_real_tumbling_cube_is_never_lost(shared_data: Path):
    """18 tags, two cameras: a pose in every frame that shows a tag, no jump, and 0.6 px with the tags as they are
    printed and their edges spread (docs/results/vision.md)."""
    detections, cameras, layout = _recording(shared_data, 15)
    tracked = track_scene(detections, cameras, layout, settings=EVERYTHING)
    track = tracked.tracks["cube"]
    assert len(track.t) == len({d.t for d in detections})
    assert tracked.report.rms < 0.6
    assert len(tracked.report.prints) == 17
    assert 0.6 < tracked.report.rms_bare < 1.0
    dt = np.diff(track.t)
    assert (np.linalg.norm(np.diff(track.q[:, :3], axis=0), axis=1) / dt).max() < 1.5
    assert tracked.report.unplaced == []
