"""What a recording calibrates and contradicts: tags, cameras, rigs, lengths, prints and sizes, against truth."""

from __future__ import annotations

import re
from collections import Counter
from dataclasses import replace

import numpy as np
import pytest

from tests.vision.sights import alike, apart, filmed_tumble, nees, track, tumble, wall
from tossid.errors import InputError
from tossid.objects import ObjectModel
from tossid.rotations import transform, transform_inv, transform_points
from tossid.settings.tracking import TrackSettings
from tossid.types import Detection
from tossid.vision.cameras.camera import Camera
from tossid.vision.cameras.rig import default_rig
from tossid.vision.pose_graph.reprojection import printed_corners
from tossid.vision.pose_graph.scene import corner_growth, observe
from tossid.vision.pose_graph.setup_checks import check_set_up
from tossid.vision.pose_graph.state import given
from tossid.vision.pose_graph.track import Tracked, track_scene
from tossid.vision.setup.layout import Body, BodyTag, Measurement, TagLayout, layout_of

EVERYTHING = TrackSettings(max_sigma=np.inf, max_angle_sigma=np.inf)


def _without(layout: TagLayout, *, but: int | None = None) -> TagLayout:
    """The layout with the poses of its moving bodies' tags unknown, but for one."""
    bodies = []
    for body in layout.bodies:
        tags = [tag if body.is_static or tag.id == but else BodyTag(tag.id, tag.size, None) for tag in body.tags]
        bodies.append(replace(body, tags=tuple(tags)))
    return replace(layout, bodies=tuple(bodies))


# ---------------------------------------------------------------- tags, cameras, rigs


def test_a_cubes_tags_are_calibrated(tagged: ObjectModel) -> None:
    """Poses of five tags unknown, no two of the opposite ones ever seen together by one camera: within 0.2 mm."""
    cameras = default_rig()
    detections, q = filmed_tumble(cameras, tagged, np.random.default_rng(0), n=250)
    tracked = track_scene(detections, cameras, _without(layout_of(tagged), but=0))
    found = {tag.id: tag for tag in tracked.layout.bodies[-1].tags}
    errors = []
    for tag in tagged.tags[1:]:
        T = found[tag.id].T_body_tag
        assert (np.array(apart(T, tag.T_body_tag)) < 0.2).all()
        errors.append((T[:3, :3].T @ (T[:3, 3] - tag.T_body_tag[:3, 3])) / found[tag.id].position_noise)
    assert 0.3 < np.mean(np.square(errors)) < 3.0
    poses = tracked.tracks["cube"]
    assert len(poses.t) == 250
    assert np.mean(nees(poses, q)) == pytest.approx(1.0, abs=0.25)
    report = tracked.report
    assert set(report.tags) == {1, 2, 3, 4, 5}
    assert (report.spread, report.prints, report.rms) == (0, {}, report.rms_bare)  # good tags have no flaws


def test_without_any_known_tag_one_of_them_is_the_frame(tagged: ObjectModel) -> None:
    cameras = default_rig()
    detections, _ = filmed_tumble(cameras, tagged, np.random.default_rng(1), n=120)
    tracked = track_scene(detections, cameras, _without(layout_of(tagged)))
    T = {tag.id: tag.T_body_tag for tag in tracked.layout.bodies[-1].tags}
    (frame,) = [tag_id for tag_id, pose in T.items() if np.array_equal(pose, np.eye(4))]
    true = {tag.id: tag.T_body_tag for tag in tagged.tags}
    for tag_id, pose in T.items():
        assert apart(pose, transform_inv(true[frame]) @ true[tag_id])[0] < 0.3


def test_cameras_are_calibrated_without_a_common_view(tagged: ObjectModel) -> None:
    """The first and the last camera never see the cube at the same time."""
    cameras = default_rig(n_cameras=3)
    detections, _ = filmed_tumble(cameras, tagged, np.random.default_rng(2), n=200)
    seen = [d for d in detections if not (d.camera == "cam0" and d.t > 0.7) and not (d.camera == "cam2" and d.t < 0.7)]
    unknown = [cameras[0], *(replace(camera, T_rig_cam=None) for camera in cameras[1:])]
    tracked = track_scene(seen, unknown, layout_of(tagged))
    for found, true in zip(tracked.cameras, cameras, strict=True):
        distance, angle = apart(found.T_rig_cam, true.T_rig_cam)
        assert distance < 2.0
        assert angle < 0.1
    assert [camera.T_rig_cam_cov is None for camera in tracked.cameras] == [True, False, False]
    assert set(tracked.report.cameras) == {"cam1", "cam2"}
    assert tracked.report.cameras["cam1"].distance is None  # no place was given
    assert tracked.report.unplaced == []
    with pytest.raises(InputError, match="no camera can be placed"):
        track_scene(seen, [replace(camera, T_rig_cam=None) for camera in cameras], layout_of(tagged))


def test_measured_lengths_weigh() -> None:
    detections, cameras, layout = wall(np.random.default_rng(5), noise=0.5)
    true = np.hypot(1.0, 0.8)
    # said to be 3 mm further apart than it looks, very surely; or at a height that it has not
    far = Measurement("far", ((0, 0), (3, 0)), 1.003 * true, 1e-5)
    level = Measurement("level", ((1, None),), 3.01, 1e-6, np.array([0.0, 0, 1]))

    def tags(*measurements: Measurement) -> dict[int, np.ndarray]:
        tracked = track_scene(detections, cameras, replace(layout, measurements=measurements), settings=EVERYTHING)
        return {tag.id: tag.T_body_tag for tag in tracked.layout.bodies[0].tags}

    def length(T: dict[int, np.ndarray]) -> float:
        return float(np.linalg.norm((T[0] - T[3])[:3] @ [-0.1, -0.1, 0, 1]))

    assert length(tags()) == pytest.approx(true, abs=0.004)
    held = tags(far, level)
    assert length(held) == pytest.approx(1.003 * true, abs=1e-4)
    assert held[1][2, 3] == pytest.approx(3.01, abs=1e-4)


def test_a_scene_where_nothing_moves_is_only_calibrated() -> None:
    detections, cameras, layout = wall(np.random.default_rng(10), noise=0.05)
    still = [replace(d, t=d.t + k) for k in range(3) for d in detections[20:24]]
    tracked = track_scene(still, cameras, replace(layout, bodies=(layout.bodies[0], Body("rig", True))))
    assert tracked.tracks == {}
    np.testing.assert_allclose(tracked.layout.bodies[0].tags[3].T_body_tag[:3, 3], [0.5, 0.4, 3.0], atol=0.05)
    assert tracked.layout.bodies[1].T_map_body is not None


# ---------------------------------------------------------------- tags that are no flat squares

PRINTS = np.array(
    [[0, 0, 0], [-0.006, -0.011, 0.01], [0.02, 0.01, 0], [-0.006, -0.011, -0.01], [0, 0, 0], [0.01, -0.01, 0]]
)
"""Of tags 0 to 5: wider, higher, twisted."""
SPREAD, NOISE = 0.5, 0.1


def _badly_printed(model: ObjectModel, rng: np.random.Generator) -> tuple[list[Detection], np.ndarray]:
    """A tumble whose tags are printed as `PRINTS` says, and whose edges spread otherwise in each image [px]."""
    t, q = tumble(300, rng)
    found = []
    for now, pose in zip(t, q, strict=True):
        T_world_body = transform(pose[:3], pose[3:7])
        for camera in default_rig():
            for tag, shape in zip(model.tags, printed_corners(PRINTS), strict=True):
                T = T_world_body @ tag.T_body_tag
                view = camera.T_world_cam[:3, 3] - T[:3, 3]
                if T[:3, 2] @ view > 0.35 * np.linalg.norm(view):
                    corners = camera.project(transform_points(T, 0.5 * tag.size * shape))
                    corners = corners + SPREAD * rng.normal() * corner_growth(corners[None])[0]
                    corners += NOISE * rng.normal(size=(4, 2))
                    found.append(Detection(camera.name, float(now), tag.id, corners, alike(NOISE)))
    return found, q


def _errors(tracked: Tracked, q: np.ndarray) -> np.ndarray:
    (found,) = tracked.tracks.values()
    index = np.round(found.t * 148).astype(int)
    T = transform_inv(transform(q[index, :3], q[index, 3:7])) @ transform(found.q[:, :3], found.q[:, 3:7])
    return np.linalg.norm(T[:, :3, 3], axis=1)


def test_prints_and_spread_are_found(tagged: ObjectModel, monkeypatch: pytest.MonkeyPatch) -> None:
    """Prints within a tenth of a percent where they are off by up to two, and poses that are better for it."""
    detections, q = _badly_printed(tagged, np.random.default_rng(3))
    layout = _without(layout_of(tagged), but=0)
    tracked = track_scene(detections, default_rig(), layout)
    report = tracked.report
    assert report.spread == pytest.approx(SPREAD, rel=0.3)
    assert report.rms < 1.2 * 2**0.5 * NOISE < report.rms_bare
    # what all have in common is the cube's size, which the first tag's own size holds
    np.testing.assert_allclose([report.prints[i] for i in range(1, 6)], PRINTS[1:], atol=2e-3)
    monkeypatch.setattr("tossid.vision.pose_graph.robust.TAG_MODEL_PASSES", 0)
    plain = track_scene(detections, default_rig(), layout)
    assert (plain.report.spread, plain.report.prints) == (0, {})
    assert np.median(_errors(tracked, q)) < 0.7 * np.median(_errors(plain, q))


# ---------------------------------------------------------------- what the images contradict


def _of_size(model: ObjectModel, factor: float, only: int | None = None) -> ObjectModel:
    """The object with tags of another size, all or one, where they were."""
    tags = (replace(tag, size=factor * tag.size) if only in (None, tag.id) else tag for tag in model.tags)
    return model.with_changes(tags=tuple(tags))


def _moved(model: ObjectModel, which: int) -> ObjectModel:
    """The object with a tag that is 5 mm aside on its face."""
    tags = list(model.tags)
    T = tags[which].T_body_tag.copy()
    T[:3, 3] += T[:3, :3] @ [0.003, 0.004, 0.0]
    tags[which] = replace(tags[which], T_body_tag=T)
    return model.with_changes(tags=tuple(tags))


A, B, C = default_rig()


@pytest.mark.parametrize(
    ("seed", "change", "filming", "expected", "says"),
    [
        (2, lambda cube: _moved(cube, 4), (A, B, C), [("tag", "4")], "5.0 mm"),
        (2, None, (replace(A, name="cam1"), replace(B, name="cam0"), C), [("swapped", "cam0 and cam1")], ""),
        (2, None, (A, replace(B, intrinsics=B.intrinsics * [1.03, 1.03, 1, 1]), C), [("intrinsics", "cam1")],
         "focal length (+3.0 %)"),
        (2, lambda cube: _of_size(cube, 0.8), (A, B, C), [("size", "cube")], "appear 0.80 times as large as stated"),
        # in half of the tumbles, a camera is suspected instead
        (3, lambda cube: _of_size(cube, 0.9, only=3), (A, B, C), [("size", "3")], "appears 0.90 times"),
        (2, lambda cube: _of_size(cube, 1.01), (A, B, C), [], ""),  # ink spreads a little
    ],
)  # fmt: skip
def test_a_part_of_the_set_up_that_the_images_contradict_is_named(
    tagged: ObjectModel,
    seed: int,
    change: object,
    filming: tuple[Camera, ...],
    expected: list[tuple[str, str]],
    says: str,
) -> None:
    filmed = change(tagged) if callable(change) else tagged
    detections, _ = filmed_tumble(filming, filmed, np.random.default_rng(seed), n=100)
    suspects = track(detections, (A, B, C), tagged)[1].suspects
    assert [(suspect.kind, suspect.name) for suspect in suspects] == expected
    assert says in "".join(suspect.message for suspect in suspects)


def test_a_moved_camera_is_reported_even_where_no_pose_is_left(tagged: ObjectModel) -> None:
    T = C.T_rig_cam.copy()
    T[:3, 3] += [0.05, 0.0, 0.0]
    detections, _ = filmed_tumble((A, B, replace(C, T_rig_cam=T)), tagged, np.random.default_rng(2), n=100)
    with pytest.raises(InputError, match=r"camera cam2 is 50 mm and 0\.0° from where it is said to be"):
        track(detections, (A, B, C), tagged)


@pytest.mark.parametrize(("n_cameras", "factor"), [(3, 1.06), (2, 10.0), (1, 0.0254)])
def test_tags_of_another_size_than_stated_are_reported_with_the_factor(
    tagged: ObjectModel, n_cameras: int, factor: float
) -> None:
    """Stated over the white border, or in other units: what is filmed is `factor` times as large."""
    cameras = default_rig()[:n_cameras]
    detections, _ = filmed_tumble(cameras, tagged, np.random.default_rng(2), n=100)
    scene = observe(detections, cameras, layout_of(_of_size(tagged, 1 / factor)), dropped=Counter())
    (suspect,) = check_set_up(scene, given(scene))
    assert (suspect.kind, suspect.name) == ("size", tagged.body_names[0])
    said = re.search(r"appear ([\d.]+) times as large as stated", suspect.message)
    assert said
    assert float(said[1]) == pytest.approx(factor, rel=0.01)
