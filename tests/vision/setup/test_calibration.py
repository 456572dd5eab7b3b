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


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "no mapping"),
        ("cam0: [", "YAML"),
        ("cam0: {intrinsics: [1, 2, 3, 4]}", "resolution"),
        ("cam0: {intrinsics: [1, 2, x, 4], resolution: [4, 4]}", "intrinsics is 'x'"),
        ("cam0: {intrinsics: [1, 2, .nan, 4], resolution: [4, 4]}", "finite"),
        ("cam0: {intrinsics: [1, 2, 3, 4, 5], resolution: [4, 4]}", "intrinsics"),
        ("cam0: {intrinsics: [-1, 2, 3, 4], resolution: [4, 4]}", "intrinsics"),
        ("cam0: {intrinsics: [1, 2, 3, 4], resolution: [4, 0]}", "resolution"),
        ("cam0: {intrinsics: [1, 2, 3, 4], resolution: [4, 4], distortion_model: fov}", "fov"),
        ("cam0: {intrinsics: [1, 2, 3, 4], resolution: [4, 4], camera_model: omni}", "omni"),
    ],
)
def test_a_damaged_calibration_is_named(tmp_path: Path, text: str, words: str):
    (tmp_path / "cameras.yaml").write_text(text)
    with pytest.raises(FileError, match=words) as caught:
        read_cameras(tmp_path)
    assert caught.value.path == tmp_path / "cameras.yaml"
    assert caught.value.__cause__ is not caught.value
