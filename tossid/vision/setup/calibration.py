"""Camera calibration files: Kalibr/TagSLAM `cameras.yaml` and TagSLAM's `camera_poses.yaml`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from numpy.typing import NDArray

from tossid.errors import FileError, InputError, brief
from tossid.rotations import transform_inv
from tossid.vision.cameras.camera import DISTORTION_MODELS, Camera
from tossid.vision.setup.layout import TagLayout
from tossid.vision.setup.tagslam import EXACT, pose_mapping, read_noise, read_tagslam
from tossid.yaml_files import check_keys, number, numbers, read_pose, read_yaml

Array = NDArray[np.float64]

RIGID = 1e-4
"""Wiggle of a camera on its rig [rad, m] up to which it is rigid; TagSLAM's own default is 1e-5."""

_WIGGLE = ("wiggle_rotation", "wiggle_translation")
_READ = (
    "camera_model",
    "intrinsics",
    "distortion_model",
    "distortion_coeffs",
    "distortion_coefficients",
    "resolution",
    "T_cn_cnm1",
    "rostopic",
    "tagtopic",
    "rig_body",
    *_WIGGLE,
    "rate_hz",
    "clock_offset",
)
_UNUSED = (
    *("cam_overlaps", "T_cam_imu", "T_imu_cam", "timeshift_cam_imu", "line_delay"),  # of Kalibr, and its readers
    *("frame_id", "frameId", "is_static", "T_cam_body", "fixed_intrinsics", "fixed_extrinsics"),  # TagSLAM and its kin
    *("sensor_type", "comment", "T_BS"),  # EuRoC
    *("camera_name", "rectification_matrix", "projection_matrix"),  # ROS's camera_info
)
_INTRINSICS, _SIZE = "intrinsics: [fx, fy, cx, cy]", "resolution: [width, height]"
_INSTEAD = {
    **dict.fromkeys(("camera_matrix", "K", "projection_parameters", "fx", "fy", "cx", "cy"), _INTRINSICS),
    **dict.fromkeys(("image_width", "image_height", "width", "height"), _SIZE),
    **dict.fromkeys(("distortion_parameters", "D", "dist_coeffs"), "distortion_coeffs: [k1, k2, p1, p2]"),
    "model_type": "camera_model: pinhole",
}
_MODELS = {"rad_tan": "radtan", "radial-tangential": "radtan", "equi": "equidistant", "fisheye": "equidistant"}
"""Names of distortion models in TagSLAM, EuRoC and OpenCV."""


def read_cameras(folder: str | Path, *, layout: TagLayout | None = None) -> tuple[Camera, ...]:
    """Read the cameras of a folder, in the file's order.

    `cameras.yaml` is Kalibr's form, with TagSLAM's topics, and `clock_offset` [s] where a camera's time
    stamps are late; poses on the rig come from `camera_poses.yaml` (T_rig_cam with R, the root of its
    information), or from Kalibr's chain `T_cn_cnm1`, the first camera being the rig. The
    rig's own pose comes from `layout`, by default the folder's `tagslam.yaml` if there is one; without
    either, the rig is the world. A moving rig leaves `T_world_rig` None.

    Raises:
        FileError: a file is missing, damaged, or says what no camera can be.
    """
    folder = Path(folder)
    path = folder / "cameras.yaml"
    content = read_yaml(path)
    if layout is None and (folder / "tagslam.yaml").exists():
        layout = read_tagslam(folder / "tagslam.yaml")
    poses_path = folder / "camera_poses.yaml"
    poses = read_yaml(poses_path) if poses_path.exists() else None
    cameras: list[Camera] = []
    T_rig_previous: Array | None = None
    if poses is not None:
        _check_pose_names(poses_path, poses, content)
    for name, entry in content.items():
        if not isinstance(entry, dict):
            raise FileError(
                path, f"{name} is {brief(entry)}, expected a camera's name with its intrinsics and resolution"
            )
        if poses is not None:
            T_rig_cam, cov = _rig_pose(poses_path, str(name), poses)
        else:
            T_rig_cam, cov = _kalibr_pose(path, str(name), entry, T_rig_previous, first=not cameras), None
        T_rig_previous = T_rig_cam
        rig = str(entry.get("rig_body", "rig"))
        T_world_rig: Array | None = np.eye(4)
        if layout is not None:
            body = layout.body(rig)
            if body is None:
                raise FileError(path, f"{name}.rig_body '{rig}' is no body of tagslam.yaml")
            T_world_rig = body.T_map_body
        cameras.append(replace(_read_camera(path, str(name), entry, rig, T_rig_cam, T_world_rig), T_rig_cam_cov=cov))
    if not cameras:
        raise FileError(path, "holds no camera")
    return tuple(cameras)


def _read_camera(
    path: Path, name: str, entry: dict[str, Any], rig: str, T_rig_cam: Array | None, T_world_rig: Array | None
) -> Camera:
    check_keys(path, name, entry, _READ, unused=_UNUSED, instead=_INSTEAD)
    missing = [key for key in ("intrinsics", "resolution") if key not in entry]
    if missing:
        raise FileError(path, f"{name} has no {', '.join(missing)}")
    if entry.get("camera_model", "pinhole") != "pinhole":
        raise FileError(path, f"{name}.camera_model is {brief(entry['camera_model'])}, expected pinhole")
    size = numbers(path, f"{name}.resolution", entry["resolution"], 2, meaning="width, height")
    if (size < 1).any() or (size % 1 != 0).any():
        raise FileError(path, f"{name}.resolution is {size.tolist()}, expected whole numbers of pixels")
    intrinsics = numbers(path, f"{name}.intrinsics", entry["intrinsics"], 4, meaning="fx, fy, cx, cy")
    model, coefficients = _distortion(path, name, entry)
    clock_offset = number(path, f"{name}.clock_offset", entry.get("clock_offset", 0.0))
    wiggle = tuple(number(path, f"{name}.{key}", entry.get(key, 0.0)) for key in _WIGGLE)
    if min(wiggle) < 0:
        raise FileError(path, f"{name}: {' and '.join(_WIGGLE)} are {list(wiggle)}, expected none below 0")
    rate_hz = None if entry.get("rate_hz") is None else number(path, f"{name}.rate_hz", entry["rate_hz"])
    if rate_hz is not None and rate_hz <= 0:
        raise FileError(path, f"{name}.rate_hz is {rate_hz:g}, expected a positive number of frames a second")
    image_topic, tag_topic = (entry.get(key) or "" for key in ("rostopic", "tagtopic"))
    if not isinstance(image_topic, str) or not isinstance(tag_topic, str):
        raise FileError(path, f"{name}: rostopic is {brief(image_topic)}, tagtopic {brief(tag_topic)}, expected names")
    try:
        return Camera(
            name=name,
            resolution=(int(size[0]), int(size[1])),
            intrinsics=intrinsics,
            distortion_model=model,
            distortion=coefficients,
            T_rig_cam=T_rig_cam,
            T_world_rig=T_world_rig,
            rig_body=rig,
            rate_hz=rate_hz,
            wiggle=(wiggle[0], wiggle[1]) if max(wiggle) > RIGID else None,
            clock_offset=clock_offset,
            image_topic=image_topic,
            tag_topic=tag_topic,
        )
    except InputError as error:
        raise FileError(path, str(error)) from error


def _distortion(path: Path, name: str, entry: dict[str, Any]) -> tuple[str, Array]:
    """The model of a camera's distortion, and its coefficients, which have to be there."""
    model = str(entry.get("distortion_model", "none"))
    model = _MODELS.get(model, model)
    if model not in DISTORTION_MODELS:
        known = ", ".join(DISTORTION_MODELS)
        raise FileError(path, f"{name}.distortion_model is {brief(model)}, expected one of {known}")
    keys = [key for key in ("distortion_coeffs", "distortion_coefficients") if key in entry]
    if len(keys) > 1:
        raise FileError(path, f"{name} has both {' and '.join(keys)}, expected one")
    key = keys[0] if keys else "distortion_coeffs"
    counts = DISTORTION_MODELS[model]
    if entry.get(key) is None and 0 not in counts:
        wanted = f"its {' or '.join(map(str, counts))} coefficients, or distortion_model: none"
        raise FileError(path, f"{name}.distortion_model is {model}, but there are no {key}; expected {wanted}")
    coefficients = numbers(path, f"{name}.{key}", entry.get(key) or [], counts, meaning=f"distortion_model: {model}")
    if model == "none" and coefficients.any():
        models = ", ".join(model for model in DISTORTION_MODELS if model != "none")
        raise FileError(path, f"{name} has {key} but no distortion_model; expected one of {models}")
    return model, coefficients


def _check_pose_names(path: Path, poses: dict[str, Any], cameras: dict[str, Any]) -> None:
    """Refuse poses of which none is of a camera: they would be left out without a word."""
    names, posed = list(map(str, cameras)), list(map(str, poses))
    if posed and not set(names) & set(posed):
        raise FileError(path, f"has no pose of a camera of cameras.yaml ({', '.join(names)}), but {', '.join(posed)}")


def _rig_pose(path: Path, name: str, poses: dict[str, Any]) -> tuple[Array | None, Array | None]:
    """T_rig_cam and its covariance."""
    entry = poses.get(name)
    if entry is None:
        return None, None
    if not isinstance(entry, dict) or not isinstance(entry.get("pose"), dict):
        raise FileError(path, f"{name} is {brief(entry)}, expected pose with position and rotation")
    check_keys(path, name, entry, ("pose",))
    pose, where = entry["pose"], f"{name}.pose"
    T_rig_cam = read_pose(path, where, pose)
    if pose.get("R") is not None:
        root = numbers(path, f"{where}.R", pose["R"], 36).reshape(6, 6)
        information = root @ root.T  # TagSLAM's code takes the list column by column; its own files are meant so
        if np.linalg.cond(information) > 1e16:
            raise FileError(path, f"{where}.R is singular; expected the root of the pose's information")
        return T_rig_cam, np.asarray(np.linalg.inv(information))
    position, rotation = read_noise(path, where, pose)
    if position is None or rotation is None:
        return T_rig_cam, None
    return T_rig_cam, np.diag(np.concatenate([rotation, position]) ** 2)


def _kalibr_pose(
    path: Path, name: str, entry: dict[str, Any], T_rig_previous: Array | None, *, first: bool
) -> Array | None:
    if "T_cn_cnm1" not in entry:
        return np.eye(4) if first else None
    rows = entry["T_cn_cnm1"]
    if T_rig_previous is None:
        raise FileError(path, f"{name}.T_cn_cnm1 refers to a camera before it that has no pose")
    if not isinstance(rows, list) or len(rows) != 4:
        raise FileError(path, f"{name}.T_cn_cnm1 is not a 4 by 4 matrix")
    T = np.stack([numbers(path, f"{name}.T_cn_cnm1", row, 4) for row in rows])
    if np.abs(T[:3, :3] @ T[:3, :3].T - np.eye(3)).max() > 1e-3 or np.abs(T[3] - [0, 0, 0, 1]).max() > 1e-9:
        raise FileError(path, f"{name}.T_cn_cnm1 is no rigid transform")
    return T_rig_previous @ transform_inv(T)


def write_cameras(cameras: Sequence[Camera], folder: str | Path) -> None:
    """Write `cameras.yaml` and `camera_poses.yaml` into an existing folder."""
    folder = Path(folder)
    entries: dict[str, Any] = {}
    poses: dict[str, Any] = {}
    for camera in cameras:
        entries[camera.name] = {
            "camera_model": "pinhole",
            "intrinsics": camera.intrinsics.tolist(),
            "distortion_model": camera.distortion_model,
            "distortion_coeffs": camera.distortion.tolist(),
            "resolution": [int(n) for n in camera.resolution],
            "rostopic": camera.image_topic or f"/{camera.name}/image_raw",
            "tagtopic": camera.tag_topic or f"/{camera.name}/tags",
            "rig_body": camera.rig_body,
        }
        if camera.rate_hz is not None:
            entries[camera.name]["rate_hz"] = float(camera.rate_hz)
        if camera.clock_offset:
            entries[camera.name]["clock_offset"] = float(camera.clock_offset)
        if camera.wiggle is not None:
            entries[camera.name] |= dict(zip(("wiggle_rotation", "wiggle_translation"), camera.wiggle, strict=True))
        if camera.T_rig_cam is not None:
            pose: dict[str, Any] = dict(pose_mapping(camera.T_rig_cam))
            cov = EXACT**2 * np.eye(6) if camera.T_rig_cam_cov is None else camera.T_rig_cam_cov
            pose["R"] = np.linalg.cholesky(np.linalg.inv(cov)).ravel().tolist()
            poses[camera.name] = {"pose": pose}
    (folder / "cameras.yaml").write_text(yaml.safe_dump(entries, sort_keys=False), encoding="utf-8")
    (folder / "camera_poses.yaml").write_text(yaml.safe_dump(poses, sort_keys=False), encoding="utf-8")
