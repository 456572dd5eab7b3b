"""Calibration and tag files: TagSLAM's own are read, ours come back as they were, damage is named."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
import pytest
import yaml
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from tossid.errors import FileError, ObjectError
from tossid.objects import ObjectModel
from tossid.rotations import transform, transform_from_rotvec, transform_points, xyzw_to_wxyz
from tossid.vision.calibration import read_cameras, write_cameras
from tossid.vision.camera import Camera
from tossid.vision.faces import tag_corners
from tossid.vision.layout import Body, BodyTag, TagLayout, layout_of, object_tags
from tossid.vision.rig import default_rig, look_at
from tossid.vision.tagslam import pose_mapping, read_pose, read_tagslam, write_tagslam

number = st.floats(-3.0, 3.0, allow_nan=False)


@settings(max_examples=100, deadline=None)
@given(values=st.lists(number, min_size=6, max_size=6))
def test_a_pose_comes_back_from_yaml(values: list[float]):
    rotvec = np.array(values[3:])
    if np.linalg.norm(rotvec) > 3.1:
        rotvec *= 3.1 / np.linalg.norm(rotvec)
    T = transform_from_rotvec(values[:3], rotvec)
    again = read_pose(Path("x"), "pose", yaml.safe_load(yaml.safe_dump(pose_mapping(T))))
    np.testing.assert_allclose(again, T, atol=1e-12)


def test_cameras_come_back_as_written(tmp_path: Path):
    cameras = [
        *default_rig(),
        Camera(
            "wide",
            (320, 240),
            [150, 151, 160, 120],
            "equidistant",
            [0.01, -0.02, 0.003, 0.0],
            look_at([1, 0, 1], [0, 0, 0]),
        ),
    ]
    write_cameras(cameras, tmp_path)
    for read, written in zip(read_cameras(tmp_path), cameras, strict=True):
        assert (read.name, read.resolution, read.distortion_model) == (
            written.name,
            written.resolution,
            written.distortion_model,
        )
        assert read.rate_hz == written.rate_hz
        np.testing.assert_array_equal(read.intrinsics, written.intrinsics)
        np.testing.assert_array_equal(read.distortion, written.distortion)
        np.testing.assert_allclose(read.T_world_cam, written.T_world_cam, atol=1e-12)


@settings(max_examples=20, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(values=st.lists(number, min_size=6, max_size=6), size=st.floats(0.01, 0.5))
def test_tag_layouts_come_back_as_written(tmp_path: Path, values: list[float], size: float):
    T = transform_from_rotvec(values[:3], np.array(values[3:]) / 2)
    layout = TagLayout(
        (
            Body("lab", True, T, size, (BodyTag(9, size, None),)),
            Body("thing", False, None, None, (BodyTag(3, size, T, np.full(3, 1e-5), np.full(3, 0.1)),)),
        ),
        default_body="lab",
    )
    write_tagslam(layout, tmp_path / "tagslam.yaml")
    again = read_tagslam(tmp_path / "tagslam.yaml")
    lab, thing = again.bodies
    assert again.default_body == "lab"
    assert (lab.is_static, thing.is_static) == (True, False)
    assert lab.tags[0].T_body_tag is None
    np.testing.assert_allclose(lab.T_map_body, T, atol=1e-12)
    np.testing.assert_allclose(thing.tags[0].T_body_tag, T, atol=1e-12)
    assert thing.tags[0].size == size
    np.testing.assert_array_equal(thing.tags[0].rotation_noise, np.full(3, 0.1))


def test_an_objects_tags_survive_the_layout_file(tmp_path: Path, tagged: ObjectModel):
    write_tagslam(layout_of(tagged), tmp_path / "tagslam.yaml")
    again = object_tags(read_tagslam(tmp_path / "tagslam.yaml"), tagged.body_names)
    assert [tag.id for tag in again] == list(range(6))
    for read, tag in zip(again, tagged.tags, strict=True):
        np.testing.assert_allclose(tag_corners(read), tag_corners(tag), atol=1e-12)
    # a one-body object takes the only moving body, whatever its name; a two-body object does not
    assert len(object_tags(read_tagslam(tmp_path / "tagslam.yaml"), ["box"])) == 6
    with pytest.raises(ObjectError, match="cube"):
        object_tags(read_tagslam(tmp_path / "tagslam.yaml"), ["box", "lid"])


@pytest.mark.parametrize(
    ("test", "n_cameras", "moving_rig", "tags"),
    [
        (4, 8, False, {"wand": 5}),
        (15, 2, False, {"cube": 18}),
        (16, 1, True, {"lab": 1}),
        (17, 1, True, {"lab": 1}),
        (23, 1, False, {"tag_board": 9}),
    ],
)
def test_tagslams_own_files_are_read(shared_data: Path, test: int, n_cameras: int, moving_rig: bool, tags: dict):
    folder = shared_data / "tagslam_test" / f"test_{test}"
    layout, cameras = read_tagslam(folder / "tagslam.yaml"), read_cameras(folder)
    assert len(cameras) == n_cameras
    assert all((camera.T_world_rig is None) == moving_rig for camera in cameras)
    for name, count in tags.items():
        body = layout.body(name)
        assert body is not None
        assert len(body.tags) == count
        assert all(tag.T_body_tag is not None for tag in body.tags)


def test_a_boards_tags_lie_where_tagslam_saw_them(shared_data: Path):
    """TagSLAM's own board pose puts every tag of the board within a few pixels of its detection."""
    folder = shared_data / "tagslam_test" / "test_23"
    (camera,) = read_cameras(folder)
    tags = {tag.id: tag for tag in object_tags(read_tagslam(folder / "tagslam.yaml"), ["tag_board"])}
    data = np.load(folder / "detections.npz", allow_pickle=False)
    with (folder / "reference_poses.csv").open() as stream:
        row = list(csv.DictReader(stream))[100]
    quat = xyzw_to_wxyz([float(row[f"q{k}"]) for k in "xyzw"])
    T_world_board = transform(np.array([float(row[k]) for k in "xyz"]), quat)
    seen = np.flatnonzero(data["t_ns"] == int(row["t_ns"]))
    assert len(seen) >= 4
    for i in seen:
        expected = camera.project(transform_points(T_world_board, tag_corners(tags[int(data["tag_id"][i])])))
        assert np.abs(expected - data["corners"][i]).max() < 4.0


def test_kalibrs_camera_chain_is_read(tmp_path: Path):
    T = np.eye(4)
    T[:3, 3] = [-0.2, 0.0, 0.0]
    entry = {"camera_model": "pinhole", "intrinsics": [500, 500, 320, 240], "resolution": [640, 480]}
    entry |= {"distortion_model": "equidistant", "distortion_coeffs": [0.0, 0.0, 0.0, 0.0]}
    chain = {"cam0": entry, "cam1": {**entry, "T_cn_cnm1": T.tolist()}}
    (tmp_path / "cameras.yaml").write_text(yaml.safe_dump(chain))
    first, second = read_cameras(tmp_path)
    np.testing.assert_array_equal(first.T_world_cam, np.eye(4))
    np.testing.assert_allclose(second.T_world_cam[:3, 3], [0.2, 0.0, 0.0])
    # without a chain, the first camera is the rig, and where the others are is not known
    (tmp_path / "cameras.yaml").write_text(yaml.safe_dump({f"cam{i}": entry for i in range(3)}))
    assert [camera.T_rig_cam is None for camera in read_cameras(tmp_path)] == [False, True, True]


def test_the_noise_of_tagslams_files_is_read(shared_data: Path):
    folder = shared_data / "tagslam_test" / "test_4"
    camera = read_cameras(folder)[0]
    sigma = np.sqrt(np.diag(camera.T_rig_cam_cov))
    np.testing.assert_allclose(sigma[3:], 0.6e-3, rtol=0.2)  # its R has 1.6e3 for positions, 1.2e4 for rotations
    assert (sigma[:3] < 4e-4).all()
    aviary, wand = read_tagslam(folder / "tagslam.yaml").bodies
    np.testing.assert_allclose(aviary.position_noise, 1e-7)
    np.testing.assert_allclose(wand.tags[0].rotation_noise, 2e-5)
    (cube,) = [body for body in read_tagslam(folder.parent / "test_15" / "tagslam.yaml").bodies if not body.is_static]
    assert cube.stillness == (0.2, 0.2)


def test_measurements_remaps_and_squashes_are_read(tmp_path: Path):
    (tmp_path / "tagslam.yaml").write_text(
        """
bodies:
 - lab: {is_static: true, default_tag_size: 0.1, ignore_tags: [9]}
default_body: lab
max_hamming_distance: 1
distance_measurements:
 - wall: {tag1: 1, tag2: 2, corner1: 0, corner2: 3, distance: 1.5, noise: 0.001}
coordinate_measurements:
 - high: {tag: 1, corner: 2, direction: [0, 0, 1], length: 0.7, noise: 0.01}
plane_measurements:
 - floor: {tags: [3, 4], direction: [0, 0, 1.0], distance: 0.0, noise: 0.002}
tag_id_remap:
 - id: 20
   remaps:
    - {remap_id: 420, start_time: "1541686885.999522770", end_time: "1541686936.513937363"}
squash:
 - {time: "1527206556.891942748", tags: [85]}
 - {camera: cam1, tags: [8]}
"""
    )
    layout = read_tagslam(tmp_path / "tagslam.yaml")
    assert [m.name for m in layout.measurements] == ["wall", "high", "floor_tag_3", "floor_tag_4"]
    assert layout.measurements[0].corners == (0, 3)
    assert layout.measurements[2].corner is None
    assert (layout.remaps[0].id, layout.remaps[0].new_id) == (20, 420)
    assert layout.remaps[0].end == pytest.approx(1541686936.513937363)
    assert layout.squashes[1].camera == "cam1"
    assert layout.max_hamming == 1
    assert layout.bodies[0].ignored_tags == {9}


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "no mapping"),
        ("cam0: [", "YAML"),
        ("cam0: {intrinsics: [1, 2, 3, 4]}", "resolution"),
        ("cam0: {intrinsics: [1, 2, x, 4], resolution: [4, 4]}", "intrinsics is 'x'"),
        ("cam0: {intrinsics: [1, 2, .nan, 4], resolution: [4, 4]}", "finite"),
        ("cam0: {intrinsics: [1, 2, 3, 4], resolution: [4, 4], distortion_model: fov}", "fov"),
        ("cam0: {intrinsics: [1, 2, 3, 4], resolution: [4, 4], camera_model: omni}", "omni"),
    ],
)
def test_a_damaged_calibration_is_named(tmp_path: Path, text: str, words: str):
    (tmp_path / "cameras.yaml").write_text(text)
    with pytest.raises(FileError, match=words) as caught:
        read_cameras(tmp_path)
    assert caught.value.path == tmp_path / "cameras.yaml"


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("bodies: []", "bodies"),
        ("bodies: [{cube: {is_static: maybe}}]", "is_static"),
        ("bodies: [{cube: {is_static: false, tags: [{id: one}]}}]", "id"),
        ("bodies: [{cube: {is_static: false, tags: [{id: 1}]}}]", "size"),
        ("bodies: [{cube: {is_static: false, tags: [{id: 1, size: 1}, {id: 1, size: 1}]}}]", "twice"),
        ("bodies: [{cube: {is_static: false, tags: [{id: 1, size: 1, pose: {position: 3}}]}}]", "rotation"),
        (
            "bodies: [{a: {is_static: true, tags: [{id: 1, size: 1}]}}, "
            "{b: {is_static: true, tags: [{id: 1, size: 1}]}}]",
            "tag 1 is listed twice",
        ),
        ("bodies: [{a: {is_static: false, pose: {}}}]", "moves"),
        ("bodies: [{a: {is_static: true}}]\nsquash: [{tags: [1]}]", "time or a camera"),
        ("bodies: [{a: {is_static: true}}]\ndistance_measurements: [{d: {tag1: 1}}]", "tag2"),
        ("bodies: [{a: {is_static: true}}]\nplane_measurements: [{d: {direction: [1, 1, 0]}}]", "unit vector"),
    ],
)
def test_a_damaged_tag_layout_is_named(tmp_path: Path, text: str, words: str):
    (tmp_path / "tagslam.yaml").write_text(text)
    with pytest.raises(FileError, match=words):
        read_tagslam(tmp_path / "tagslam.yaml")


def test_the_default_rig_sees_the_whole_area():
    turn = np.linspace(0, 2 * np.pi, 40)
    for camera in default_rig(area=1.0, height=0.4):
        for z in (0.0, 0.4):
            points = np.column_stack([0.5 * np.cos(turn), 0.5 * np.sin(turn), np.full(40, z)])
            assert camera.contains(camera.project(points)).all()
