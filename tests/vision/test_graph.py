"""The pose graph against truth, and against TagSLAM's own poses of its published recordings."""

from __future__ import annotations

import csv
from collections import Counter
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.vision.sights import alike, filmed_tumble, nees
from tossid.errors import InputError
from tossid.objects import ObjectModel
from tossid.rotations import geodesic_angle, matrix_to_quat, transform, transform_inv, xyzw_to_wxyz
from tossid.types import Detection
from tossid.vision.believed import TrackSettings
from tossid.vision.calibration import read_cameras
from tossid.vision.camera import Camera
from tossid.vision.graph import solve
from tossid.vision.initial import initialise
from tossid.vision.layout import Body, BodyTag, Coordinate, Distance, Remap, Squash, TagLayout, layout_of
from tossid.vision.rig import default_rig
from tossid.vision.rosbag import read_bag_detections
from tossid.vision.scene import observe
from tossid.vision.tagslam import read_tagslam
from tossid.vision.track import Tracked, track_scene

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


def test_what_moves_may_be_the_rig(tagged: ObjectModel):
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
    whole = solve(scene, state, used, covariances=True)
    parts = solve(scene, state, used, covariances=True, window=60)
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


def _wall(rng: np.random.Generator, *, noise: float = 0.0) -> tuple[list[Detection], list[Camera], TagLayout]:
    """A camera before a wall of four tags, one of them known: a metre apart, but said to be so only by a length."""
    camera = Camera("cam0", (1280, 1024), [900, 900, 640, 512], rig_body="rig", T_world_rig=None)
    places = [transform(np.array([x, y, 3.0]), np.array([0.0, 1, 0, 0])) for x in (-0.5, 0.5) for y in (-0.4, 0.4)]
    known = BodyTag(0, 0.2, places[0])
    lab = Body("lab", True, np.eye(4), 0.2, (known, *(BodyTag(i, 0.2, None) for i in (1, 2, 3))))
    detections = []
    square = 0.1 * np.array([[-1.0, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]])
    for i in range(30):
        T = transform(np.array([0.3, 0.2, 0.5]) * np.sin(i / 4 + np.arange(3)), np.array([1.0, 0, 0, 0]))
        for tag_id, place in enumerate(places):
            world = square @ place[:3, :3].T + place[:3, 3]
            pixels = camera.distort((world - T[:3, 3]) @ T[:3, :3])[0] + noise * rng.normal(size=(4, 2))
            detections.append(Detection("cam0", i / 10, tag_id, pixels, alike(max(noise, 0.1))))
    return detections, [camera], TagLayout((lab, Body("rig", False)))


def test_measured_lengths_weigh():
    detections, cameras, layout = _wall(np.random.default_rng(5), noise=0.5)
    # said to be 3 mm further apart than it looks, very surely
    measurements = (Distance("far", (0, 3), (0, 0), 1.003 * np.hypot(1.0, 0.8), 1e-5),)
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
    level = (Coordinate("level", 1, None, np.array([0.0, 0, 1]), 3.01, 1e-6),)
    tracked = track_scene(detections, cameras, replace(layout, measurements=level), settings=EVERYTHING)
    assert tracked.layout.bodies[0].tags[1].T_body_tag[2, 3] == pytest.approx(3.01, abs=1e-4)


def test_a_static_camera_sees_a_static_tag_once():
    """Merged sightings give what all of them would, and a tag that did move is not merged."""
    detections, cameras, layout = _wall(np.random.default_rng(6), noise=0.3)
    first = [replace(d, t=k / 10) for k in range(20) for d in detections[:4]]
    rng = np.random.default_rng(7)
    first = [replace(d, corners=d.corners + 0.3 * rng.normal(size=(4, 2))) for d in first]
    static = replace(layout, bodies=(layout.bodies[0], Body("rig", True)))
    scene = observe(first, cameras, static, dropped=Counter())
    assert len(scene.step) == 4
    np.testing.assert_array_equal(scene.count, 20)
    mean = np.mean([d.corners for d in first if d.tag_id == 2], axis=0)
    np.testing.assert_allclose(scene.pixels[2], mean, atol=1e-9)
    bumped = [replace(d, corners=d.corners + 40 * (d.t > 1.0) * (d.tag_id == 3)) for d in first]
    assert len(observe(bumped, cameras, static, dropped=Counter()).step) == 3 + 20


def test_what_is_left_out_is_counted(tagged: ObjectModel):
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
    squashed = sum(d.tag_id == out and d.camera == "cam1" for d in more)
    remapped = sum(d.tag_id == away and d.t <= 0.1 for d in more)
    assert dropped["squashed"] == squashed
    assert dropped["id on no body"] == remapped + 1
    assert dropped["id seen twice in a frame"] >= 2
    assert dropped["too many corrected bits"] == 1
    assert "corners or covariance not finite" not in dropped  # it was one of two, neither to be believed


def test_a_scene_where_nothing_moves_is_only_calibrated():
    detections, cameras, layout = _wall(np.random.default_rng(10), noise=0.05)
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
    printed and their edges spread (docs/experiments/vision.md)."""
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
