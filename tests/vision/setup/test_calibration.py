"""Calibration and tag files: TagSLAM's own are read, ours come back as they were, damage is named."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import yaml

from tossid.errors import FileError
from tossid.vision.cameras.camera import Camera
from tossid.vision.cameras.rig import default_rig, look_at
from tossid.vision.setup.calibration import read_cameras, write_cameras
from tossid.vision.setup.tagslam import read_tagslam


def test_cameras_come_back_as_written(tmp_path: Path):
    lens, T = ("equidistant", [0.01, -0.02, 0.003, 0.0]), look_at([1, 0, 1], [0, 0, 0])
    cameras = [*default_rig(), Camera("wide", (320, 240), [150, 151, 160, 120], *lens, T)]
    write_cameras(cameras, tmp_path)
    for read, written in zip(read_cameras(tmp_path), cameras, strict=True):
        for name in ("name", "resolution", "distortion_model", "rate_hz"):
            assert getattr(read, name) == getattr(written, name)
        np.testing.assert_array_equal(read.intrinsics, written.intrinsics)
        np.testing.assert_array_equal(read.distortion, written.distortion)
        np.testing.assert_allclose(read.T_world_cam, written.T_world_cam, atol=1e-12)


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


GOOD = "intrinsics: [500, 501, 320, 240], resolution: [640, 480]"


@pytest.mark.parametrize(
    ("entry", "distortion"),
    [
        # Kalibr, with an IMU and after its readers; EuRoC's sensor.yaml; TagSLAM; ROS's and OpenCV's matrices
        ("cam_overlaps: [1], camera_model: pinhole, distortion_model: radtan, distortion_coeffs: [-0.2, 0.1, 0, 0], "
         "timeshift_cam_imu: 0.01, T_cam_imu: [[1, 0, 0, 0]], T_imu_cam: [], line_delay: 1e-5",
         ("radtan", [-0.2, 0.1, 0, 0])),
        ("sensor_type: camera, comment: VI-Sensor cam0, T_BS: {cols: 4, rows: 4, data: []}, rate_hz: 20, "
         "distortion_model: radial-tangential, distortion_coefficients: [-0.28, 0.07, 2e-4, 1e-5]",
         ("radtan", [-0.28, 0.07, 2e-4, 1e-5])),
        ("frame_id: cam0, is_static: true, distortion_model: fisheye, distortion_coeffs: [0.1, 0, 0, 0], "
         "tagtopic: /t, wiggle_rotation: 0.01", ("equidistant", [0.1, 0, 0, 0])),
        ("camera_name: left, distortion_model: plumb_bob, projection_matrix: {rows: 3, cols: 4, data: []}, "
         "distortion_coefficients: {rows: 1, cols: 5, data: [-0.3, 0.1, 0, 0, 0.01]}",
         ("plumb_bob", [-0.3, 0.1, 0, 0, 0.01])),
        ("distortion_model: none, distortion_coeffs: []", ("none", [])),
    ],
)  # fmt: skip
def test_what_other_tools_write_is_read(tmp_path: Path, entry: str, distortion: tuple[str, list[float]]):
    (tmp_path / "cameras.yaml").write_text(f"%YAML:1.0\n---\ncam0: {{{entry}, {GOOD}}}\n")
    (camera,) = read_cameras(tmp_path)
    assert (camera.distortion_model, camera.distortion.tolist()) == distortion
    assert camera.intrinsics.tolist() == [500, 501, 320, 240]


SIZE = "resolution: [640, 480]"


@pytest.mark.parametrize(
    ("entry", "says"),
    [
        (f"distortion_model: radtan, distortion_coefs: [1, 0, 0, 0], {GOOD}", "mean 'distortion_coeffs'"),
        (f"distortion_model: radtan, {GOOD}", "radtan, but there are no distortion_coeffs; expected its 4 or 5"),
        (f"distortion_model: equidistant, distortion_coeffs: , {GOOD}", "expected its 4 coefficients, or .* none"),
        (f"distortion_model: equidistant, distortion_coeffs: [1, 2, 3, 4, 5], {GOOD}", "has 5 numbers, expected 4"),
        (f"distortion_coeffs: [0.1, 0, 0, 0], {GOOD}", "has distortion_coeffs but no distortion_model"),
        (f"distortion_coeffs: [0], distortion_coefficients: [0], distortion_model: radtan, {GOOD}", "has both"),
        ("camera_matrix: {data: [5]}, resolution: [4, 4]", r"expected intrinsics: \[fx, fy, cx, cy\]"),
        ("image_width: 640, image_height: 480, intrinsics: [1, 1, 1, 1]", r"expected resolution: \[width, height\]"),
        ("model_type: PINHOLE, projection_parameters: {fx: 1}", "model_type is no key .*; expected camera_model"),
        (f"intrinsics: [500, 0, 320, 0, 501, 240, 0, 0, 1], {SIZE}", r"has 9 numbers, expected 4 .*\(fx"),
        (f"intrinsics: {{fx: 1, fy: 1}}, {SIZE}", "intrinsics is .*, expected 4 numbers"),
        ("intrinsics: [1, 2, x, 4], resolution: [4, 4]", "intrinsics is 'x'"),
        ("intrinsics: [500, 501, 320, 240], resolution: 640x480", r"resolution is '640x480', .*\(width, height\)"),
        ("intrinsics: [500, 501, 320, 240], resolution: [640.5, 480]", "expected whole numbers of pixels"),
        (f"rate_hz: 0, {GOOD}", "rate_hz is 0, expected a positive number"),
        (f"clock_offset: .inf, {GOOD}", "clock_offset is inf, expected a finite number"),
        (f"wiggle_rotation: -1, {GOOD}", "expected none below 0"),
        (f"rostopic: [1], {GOOD}", r"rostopic is \[1\], .* expected names"),
        (f"distortion_model: fov, {GOOD}", "fov"),
        (f"camera_model: omni, {GOOD}", "omni"),
    ],
)  # fmt: skip
def test_a_value_that_no_camera_has_is_named_with_what_is_expected(tmp_path: Path, entry: str, says: str):
    (tmp_path / "cameras.yaml").write_text(f"cam0: {{{entry}}}\n")
    with pytest.raises(FileError, match=says) as caught:
        read_cameras(tmp_path)
    assert "cameras.yaml: cam0" in str(caught.value)


@pytest.mark.parametrize(
    ("file", "text", "says"),
    [
        ("cameras.yaml", "", "no mapping"),
        ("cameras.yaml", "cam0: [", "YAML"),
        ("cameras.yaml", "cam0: pinhole", "cam0 is 'pinhole', expected a camera's name with its intrinsics"),
        ("camera_poses.yaml", "Cam0: {pose: {}}", r"has no pose of a camera of cameras.yaml \(cam0\), but Cam0"),
        ("camera_poses.yaml", "cam0: {pos: {}}", "cam0.pos is no key|expected pose with position"),
        ("camera_poses.yaml", "cam0: {pose: {positon: {x: 0, y: 0, z: 0}}}", "positon is no key.*mean 'position'"),
        ("camera_poses.yaml", "cam0: {pose: {position: {x: 0, y: 0, z: 0}, rotation: {x: 0, y: 0, z: 180}}}",
         "rotation is 180 long"),
    ],
)  # fmt: skip
def test_a_damaged_file_and_a_pose_that_no_camera_gets_are_refused(
    tmp_path: Path, file: str, text: str, says: str
) -> None:
    (tmp_path / "cameras.yaml").write_text(f"cam0: {{{GOOD}}}\n")
    (tmp_path / file).write_text(text)
    with pytest.raises(FileError, match=says) as caught:
        read_cameras(tmp_path)
    assert caught.value.path == tmp_path / file
