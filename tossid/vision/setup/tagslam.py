"""`tagslam.yaml`: the scene as TagSLAM describes it (bodies, tags, measurements), read and written."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from numpy.typing import NDArray

from tossid import budget
from tossid.errors import FileError, brief
from tossid.objects.tags import BODY_KEYS, TAG_KEYS, TAGSLAMS_BODY_KEYS
from tossid.rotations import matrix_to_rotvec, transform_inv
from tossid.vision.setup.layout import (
    DEFAULT_FAMILY,
    FAMILIES,
    Body,
    BodyTag,
    Measurement,
    Remap,
    Squash,
    TagLayout,
)
from tossid.yaml_files import check_keys, number, numbers, read_pose, read_xyz, read_yaml

Array = NDArray[np.float64]

EXACT = 1e-6
"""Standard deviation [m, rad] that is written for a pose that is known exactly."""

_TOP = (
    *("bodies", "body_defaults", "default_body", "tag_family", "max_hamming_distance", "tagslam_parameters"),
    *("distance_measurements", "coordinate_measurements", "plane_measurements", "tag_id_remap", "squash"),
)
MEASUREMENTS = {
    "distance_measurements": ("tag1", "tag2", "corner1", "corner2", "distance", "noise"),
    "coordinate_measurements": ("tag", "corner", "direction", "length", "noise"),
    "plane_measurements": ("tags", "direction", "distance", "noise"),
}
_BOARD = ("tag_start_id", "tag_size", "tag_spacing", "tag_rows", "tag_columns")
_BOARD_NOISE = ("tag_position_noise", "tag_rotation_noise")
# what TagSLAM takes in beside that, for its optimizer and what it publishes
_TOP_UNUSED = (
    *("amnesia", "warn_ignore_tags", "warn_unknown_tags", "cameras", "camera_poses", "position_measurements"),
    *("fixed_frame_id", "max_number_of_frames", "outbag", "bag_file", "playback_rate", "output_directory"),
    *("publish_ack", "write_debug_images", "has_compressed_images", "optimize_full_graph"),
    *("pixel_noise", "minimum_viewing_angle", "max_subgraph_error", "max_num_incremental_opt", "optimizer_mode"),
)


def pose_mapping(T: Array) -> dict[str, dict[str, float]]:
    """The inverse of `read_pose`."""
    rotvec = matrix_to_rotvec(T[:3, :3])
    return {
        "position": dict(zip("xyz", map(float, T[:3, 3]), strict=True)),
        "rotation": dict(zip("xyz", map(float, rotvec), strict=True)),
    }


def read_noise(path: Path, where: str, pose: dict[str, Any]) -> tuple[Array | None, Array | None]:
    """A pose's position_noise [m] and rotation_noise [rad]: (3,) each, None where not given."""
    position, rotation = (
        read_xyz(path, f"{where}.{key}", pose[key]) if pose.get(key) is not None else None
        for key in ("position_noise", "rotation_noise")
    )
    return position, rotation


def read_tagslam(path: str | Path) -> TagLayout:
    """Read `tagslam.yaml`.

    A body's pose is T_map_body, a tag's T_body_tag, rotations are rotation
    vectors [rad]. Of a board, TagSLAM's code takes the inverse of `pose`, and
    numbers its tags row by row. Ours alone is `tag_family`, of a set-up or a body, and a tag's
    `family`. `body_defaults` is the noise of bodies' poses that
    give none; a tag's pose without noise is exact.
    """
    path = Path(path)
    content = read_yaml(path)
    check_keys(path, "", content, _TOP, unused=_TOP_UNUSED, instead={"remap": "tag_id_remap"})
    entries = content.get("bodies")
    if not isinstance(entries, list) or not entries:
        raise FileError(path, "has no list 'bodies'")
    _check_count(path, entries)
    defaults = _mapping(path, "body_defaults", content.get("body_defaults") or {})
    check_keys(path, "body_defaults", defaults, ("position_noise", "rotation_noise"))
    family = _family(path, "tag_family", content.get("tag_family", DEFAULT_FAMILY))
    bodies = [_read_body(path, name, body, defaults, family) for name, body in _named(path, "bodies", entries)]
    names = [body.name for body in bodies]
    if len(set(names)) != len(names):
        raise FileError(path, f"bodies: a name occurs twice in {', '.join(names)}")
    default = content.get("default_body")
    if default is not None and default not in names:
        raise FileError(path, f"default_body: '{default}' is not among the bodies {', '.join(names)}")
    ids = Counter(tag.id for body in bodies for tag in body.tags)
    twice = sorted(tag_id for tag_id, count in ids.items() if count > 1)
    if twice:
        raise FileError(path, f"bodies: tag {twice[0]} is listed twice; an id can be on one body once")
    most = content.get("max_hamming_distance")
    return TagLayout(
        tuple(bodies),
        default,
        dict(_mapping(path, "tagslam_parameters", content.get("tagslam_parameters") or {})),
        _read_measurements(path, content),
        _read_remaps(path, content.get("tag_id_remap") or []),
        _read_squashes(path, content.get("squash") or []),
        None if most is None else int(number(path, "max_hamming_distance", most)),
        family,
    )


def _check_count(path: Path, entries: Any) -> None:
    """Refuse bodies with more tags than `ReadLimits.tags`, before any is made."""
    claimed = 0.0
    for name, body in _named(path, "bodies", entries):
        board, tags = body.get("board"), body.get("tags")
        if isinstance(board, dict):
            sizes = [number(path, f"{name}.board.{key}", board.get(key, 0)) for key in ("tag_rows", "tag_columns")]
            claimed += max(0.0, sizes[0]) * max(0.0, sizes[1])
        claimed += len(tags) if isinstance(tags, list) else 0
    budget.check_claim(path, "tags", claimed, budget.limits().tags)


def _family(path: Path, where: str, value: Any) -> str:
    name = str(value) if str(value).startswith("tag") else f"tag{value}"
    if name not in FAMILIES:
        raise FileError(path, f"{where} is {brief(value)}, expected one of {', '.join(FAMILIES)}")
    return name


def _mapping(path: Path, where: str, value: Any) -> dict[str, Any]:
    if not isinstance(value, dict):
        raise FileError(path, f"{where} is {brief(value)}, expected names with values")
    return value


def _named(path: Path, where: str, entries: Any) -> list[tuple[str, dict[str, Any]]]:
    """A list of mappings that hold one named mapping each."""
    if not isinstance(entries, list):
        raise FileError(path, f"{where} is {brief(entries)}, expected a list")
    found = []
    for entry in entries:
        if not isinstance(entry, dict) or len(entry) != 1 or not isinstance(next(iter(entry.values())), dict):
            raise FileError(path, f"{where}: {brief(entry)} is not one name with its values")
        name, value = next(iter(entry.items()))
        found.append((str(name), value))
    return found


def _read_body(path: Path, name: str, body: dict[str, Any], defaults: dict[str, Any], family: str) -> Body:
    check_keys(path, name, body, BODY_KEYS, unused=TAGSLAMS_BODY_KEYS, instead={"tag_size": "default_tag_size"})
    family = _family(path, f"{name}.tag_family", body.get("tag_family", family))
    is_static = body.get("is_static")
    if not isinstance(is_static, bool):
        raise FileError(path, f"{name}.is_static is {brief(is_static)}, expected true or false")
    size = body.get("default_tag_size")
    default_size = None if size is None else number(path, f"{name}.default_tag_size", size)
    pose = body.get("pose")
    if pose is not None and not is_static:
        raise FileError(path, f"{name}.pose: a body that moves (is_static: false) has no fixed pose")
    T_map_body = None if pose is None else read_pose(path, f"{name}.pose", pose)
    noise: list[Array | None] = [None, None]
    if pose is not None:
        for k, given in enumerate(read_noise(path, f"{name}.pose", pose)):
            key = ("position_noise", "rotation_noise")[k]
            fallback = np.full(3, number(path, f"body_defaults.{key}", defaults[key])) if key in defaults else None
            noise[k] = fallback if given is None else given
    kind = body.get("type", "simple")
    if kind == "board":
        tags = _board_tags(path, f"{name}.board", _mapping(path, f"{name}.board", body.get("board")), family)
    elif kind == "simple":
        listed = body.get("tags") or []
        if not isinstance(listed, list):
            raise FileError(path, f"{name}.tags is {brief(listed)}, expected a list of tags")
        tags = [_read_tag(path, name, tag, default_size, family) for tag in listed]
    else:
        raise FileError(path, f"{name}.type is {brief(kind)}, expected simple or board")
    override = [body.get(f"override_tag_{key}_noise") for key in ("position", "rotation")]
    if None not in override:
        p, r = (np.full(3, number(path, f"{name}.override_tag_noise", value)) for value in override)
        tags = [replace(tag, position_noise=p, rotation_noise=r) for tag in tags]
    ignored = _ids(path, f"{name}.ignore_tags", body.get("ignore_tags") or [])
    return Body(name, is_static, T_map_body, default_size, tuple(tags), noise[0], noise[1], ignored)


def _ids(path: Path, where: str, value: Any) -> frozenset[int]:
    if not isinstance(value, list) or not all(isinstance(item, int) for item in value):
        raise FileError(path, f"{where} is {brief(value)}, expected a list of tag ids")
    return frozenset(value)


def _read_tag(path: Path, body: str, tag: Any, default_size: float | None, family: str) -> BodyTag:
    if not isinstance(tag, dict) or not isinstance(tag.get("id"), int) or isinstance(tag.get("id"), bool):
        raise FileError(path, f"{body}.tags: {brief(tag)} has no whole-number id")
    where = f"{body}.tags[{tag['id']}]"
    check_keys(path, where, tag, TAG_KEYS, unused=("bits",))
    if "size" not in tag and default_size is None:
        raise FileError(path, f"{where} has no size, and {body} no default_tag_size")
    size = number(path, f"{where}.size", tag["size"]) if "size" in tag else default_size
    if size is None or size <= 0:
        raise FileError(path, f"{where}.size is {size}, expected a positive length")
    family = _family(path, f"{where}.family", tag.get("family", family))
    pose = tag.get("pose")
    if pose is None:
        return BodyTag(tag["id"], size, None, family=family)
    T_body_tag = read_pose(path, f"{where}.pose", pose)
    return BodyTag(tag["id"], size, T_body_tag, *read_noise(path, f"{where}.pose", pose), family)


def _board_tags(path: Path, where: str, board: dict[str, Any], family: str) -> list[BodyTag]:
    check_keys(path, where, board, (*_BOARD, *_BOARD_NOISE, "pose"), unused=("tag_bits",))
    missing = [key for key in _BOARD if key not in board]
    if missing:
        raise FileError(path, f"{where} has no {', '.join(missing)}")
    start, size, spacing, rows, columns = (number(path, f"{where}.{key}", board[key]) for key in _BOARD)
    T_tag0_body = read_pose(path, f"{where}.pose", board["pose"]) if board.get("pose") is not None else np.eye(4)
    noise = [np.full(3, number(path, f"{where}.{key}", board[key])) if key in board else None for key in _BOARD_NOISE]
    tags = []
    for row in range(int(rows)):
        for column in range(int(columns)):
            T = np.eye(4)
            T[:2, 3] = np.array([column, row]) * size * (1 + spacing)
            tag_id = int(start) + row * int(columns) + column
            tags.append(BodyTag(tag_id, size, transform_inv(T_tag0_body) @ T, noise[0], noise[1], family))
    return tags


def _read_measurements(path: Path, content: dict[str, Any]) -> tuple[Measurement, ...]:
    """`distance_measurements`, `coordinate_measurements`, and `plane_measurements` (coordinates of tags' centres)."""
    found: list[Measurement] = []
    for kind, keys in MEASUREMENTS.items():
        for name, entry in _named(path, kind, content.get(kind) or []):
            where = f"{kind}.{name}"
            check_keys(path, where, entry, keys)
            missing = [key for key in keys if key not in entry]
            if missing:
                raise FileError(path, f"{where} has no {missing[0]}")
            values = {
                key: number(path, f"{where}.{key}", entry[key]) for key in keys if key not in ("tags", "direction")
            }
            direction = None
            if "direction" in keys:
                direction = numbers(path, f"{where}.direction", entry["direction"], 3)
                if abs(np.linalg.norm(direction) - 1) > 1e-5:
                    raise FileError(path, f"{where}.direction is {direction.tolist()}, expected a unit vector")
            corners = {key: int(value) for key, value in values.items() if key.startswith("corner")}
            if values["noise"] <= 0 or not all(0 <= corner <= 3 for corner in corners.values()):
                raise FileError(path, f"measurement {name}: expected corners 0 to 3 and a positive noise")
            length, noise = values.get("length", values.get("distance", 0.0)), values["noise"]
            if "tags" in keys:
                for tag in sorted(_ids(path, f"{where}.tags", entry["tags"])):
                    found.append(Measurement(f"{name}_tag_{tag}", ((tag, None),), length, noise, direction))
                continue
            points = [(int(values[f"tag{k}"]), corners[f"corner{k}"]) for k in ("", 1, 2) if f"tag{k}" in keys]
            found.append(Measurement(name, tuple(points), length, noise, direction))
    return tuple(found)


def _read_remaps(path: Path, entries: Any) -> tuple[Remap, ...]:
    remaps = []
    for entry in entries if isinstance(entries, list) else [entries]:
        entry = _mapping(path, "tag_id_remap", entry)
        check_keys(path, "tag_id_remap", entry, ("id", "remaps"))
        for again in entry.get("remaps") or []:
            again = _mapping(path, "tag_id_remap.remaps", again)
            check_keys(path, "tag_id_remap.remaps", again, ("remap_id", "start_time", "end_time", "camera"))
            if not isinstance(entry.get("id"), int) or not isinstance(again.get("remap_id"), int):
                raise FileError(path, f"tag_id_remap: {brief(entry)} needs id and remap_id")
            start, end = (
                number(path, f"tag_id_remap.{key}", again[key]) if key in again else float(none)
                for key, none in (("start_time", "-inf"), ("end_time", "inf"))
            )
            remaps.append(Remap(entry["id"], again["remap_id"], start, end, again.get("camera") or None))
    return tuple(remaps)


def _read_squashes(path: Path, entries: Any) -> tuple[Squash, ...]:
    squashes = []
    for entry in entries if isinstance(entries, list) else [entries]:
        entry = _mapping(path, "squash", entry)
        check_keys(path, "squash", entry, ("tags", "time", "camera"))
        time = number(path, "squash.time", entry["time"]) if "time" in entry else None
        if time is None and not entry.get("camera"):
            raise FileError(path, f"squash: {brief(entry)} needs a time or a camera")
        tags = _ids(path, "squash.tags", entry.get("tags") or [])
        squashes.append(Squash(tags, time, entry.get("camera") or None))
    return tuple(squashes)


def write_tagslam(layout: TagLayout, path: str | Path) -> None:
    """Write a layout's bodies and tags.

    Boards are written as the tags that they consist of. Measurements, remaps and squashes belong to one recording and
    are not written.
    """
    bodies = []
    for body in layout.bodies:
        entry: dict[str, Any] = {"is_static": body.is_static, "type": "simple"}
        if body.default_tag_size is not None:
            entry["default_tag_size"] = float(body.default_tag_size)
        if body.T_map_body is not None:
            noise = (body.position_noise, body.rotation_noise)
            position, rotation = (np.full(3, EXACT) if part is None else part for part in noise)
            entry["pose"] = {**pose_mapping(body.T_map_body), **_noise_mapping(position, rotation)}
        if body.tags:
            entry["tags"] = [_tag_mapping(tag, layout.tag_family) for tag in body.tags]
        bodies.append({body.name: entry})
    content: dict[str, Any] = {"tagslam_parameters": layout.parameters} if layout.parameters else {}
    content["body_defaults"] = {"position_noise": 0.05, "rotation_noise": 0.01}
    if layout.tag_family != DEFAULT_FAMILY:
        content["tag_family"] = layout.tag_family
    if layout.default_body is not None:
        content["default_body"] = layout.default_body
    content["bodies"] = bodies
    Path(path).write_text(yaml.safe_dump(content, sort_keys=False), encoding="utf-8")


def _tag_mapping(tag: BodyTag, family: str) -> dict[str, Any]:
    entry: dict[str, Any] = {"id": int(tag.id), "size": float(tag.size)}
    if tag.family != family:
        entry["family"] = tag.family
    if tag.T_body_tag is not None:
        entry["pose"] = {**pose_mapping(tag.T_body_tag), **_noise_mapping(tag.position_noise, tag.rotation_noise)}
    return entry


def _noise_mapping(position: Array | None, rotation: Array | None) -> dict[str, Any]:
    entries = {"position_noise": position, "rotation_noise": rotation}
    return {
        key: dict(zip("xyz", map(float, values), strict=True)) for key, values in entries.items() if values is not None
    }
