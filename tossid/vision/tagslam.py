"""`tagslam.yaml`: bodies (static or moving) and the tags on them, read and written as TagSLAM has them."""

from __future__ import annotations

import contextlib
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from numpy.typing import NDArray

from tossid.errors import FileError, ObjectError
from tossid.objects import ObjectModel, Tag
from tossid.rotations import matrix_to_rotvec, transform_from_rotvec, transform_inv

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class BodyTag:
    """A tag on a body. size: outer edge of the black border [m]. T_body_tag: (4, 4), None if unknown.
    position_noise [m], rotation_noise [rad]: (3,) prior standard deviations, None if not given."""

    id: int
    size: float
    T_body_tag: Array | None
    position_noise: Array | None = None
    rotation_noise: Array | None = None


@dataclass(frozen=True, eq=False)
class Body:
    """A rigid body. T_map_body: (4, 4) of a static body, None if unknown or moving."""

    name: str
    is_static: bool
    T_map_body: Array | None = None
    default_tag_size: float | None = None
    tags: tuple[BodyTag, ...] = ()


@dataclass(frozen=True, eq=False)
class TagLayout:
    """All bodies of a scene. default_body: the body that tags not listed belong to, None for none."""

    bodies: tuple[Body, ...]
    default_body: str | None = None
    parameters: dict[str, Any] = field(default_factory=dict)

    def body(self, name: str) -> Body | None:
        """The body of that name, None if there is none."""
        return next((body for body in self.bodies if body.name == name), None)


def read_yaml(path: Path) -> dict[str, Any]:
    """A YAML file that holds a mapping. `FileError` otherwise."""
    try:
        content = yaml.safe_load(path.read_text(encoding="utf-8"))
    except FileNotFoundError as error:
        raise FileError(path, "no such file") from error
    except (OSError, UnicodeDecodeError) as error:
        raise FileError(path, f"cannot be read: {error}") from error
    except yaml.YAMLError as error:
        mark = getattr(error, "problem_mark", None)
        where = f" (line {mark.line + 1})" if mark is not None else ""
        raise FileError(path, f"is not valid YAML{where}") from error
    if not isinstance(content, dict):
        raise FileError(path, "holds no mapping of names to values")
    return content


def number(path: Path, where: str, value: Any) -> float:
    """A finite number, or `FileError`."""
    if isinstance(value, str):  # YAML 1.1 reads '1e-05' as text
        with contextlib.suppress(ValueError):
            value = float(value)
    if isinstance(value, bool) or not isinstance(value, int | float) or not np.isfinite(value):
        raise FileError(path, f"{where} is {value!r}, expected a finite number")
    return float(value)


def numbers(path: Path, where: str, value: Any, count: int | tuple[int, ...]) -> Array:
    """A list of finite numbers of the given length(s), or `FileError`."""
    counts = (count,) if isinstance(count, int) else count
    if not isinstance(value, list) or len(value) not in counts:
        raise FileError(path, f"{where} is {value!r}, expected {' or '.join(map(str, counts))} numbers")
    return np.array([number(path, where, item) for item in value], dtype=float)


def read_xyz(path: Path, where: str, value: Any) -> Array:
    """A mapping x, y, z. (3,)."""
    if not isinstance(value, dict) or not {"x", "y", "z"} <= set(value):
        raise FileError(path, f"{where} is {value!r}, expected x, y, z")
    return np.array([number(path, f"{where}.{key}", value[key]) for key in "xyz"])


def read_pose(path: Path, where: str, value: Any) -> Array:
    """A mapping position, rotation (rotation vector [rad]). (4, 4)."""
    if not isinstance(value, dict) or "position" not in value or "rotation" not in value:
        raise FileError(path, f"{where} needs position and rotation")
    position = read_xyz(path, f"{where}.position", value["position"])
    return transform_from_rotvec(position, read_xyz(path, f"{where}.rotation", value["rotation"]))


def pose_mapping(T: Array) -> dict[str, dict[str, float]]:
    """The inverse of `read_pose`."""
    rotvec = matrix_to_rotvec(T[:3, :3])
    return {
        "position": dict(zip("xyz", map(float, T[:3, 3]), strict=True)),
        "rotation": dict(zip("xyz", map(float, rotvec), strict=True)),
    }


def read_tagslam(path: str | Path) -> TagLayout:
    """Read `tagslam.yaml`.

    A body's pose is T_map_body, a tag's T_body_tag, rotations are rotation
    vectors [rad]. Of a board, TagSLAM's code takes the inverse of `pose`, and
    numbers its tags row by row.
    """
    path = Path(path)
    content = read_yaml(path)
    entries = content.get("bodies")
    if not isinstance(entries, list) or not entries:
        raise FileError(path, "has no list 'bodies'")
    bodies = []
    for entry in entries:
        if not isinstance(entry, dict) or len(entry) != 1 or not isinstance(next(iter(entry.values())), dict):
            raise FileError(path, f"bodies: {entry!r} is not one named body")
        name, body = next(iter(entry.items()))
        bodies.append(_read_body(path, str(name), body))
    names = [body.name for body in bodies]
    if len(set(names)) != len(names):
        raise FileError(path, f"bodies: a name occurs twice in {', '.join(names)}")
    default = content.get("default_body")
    if default is not None and default not in names:
        raise FileError(path, f"default_body: '{default}' is not among the bodies {', '.join(names)}")
    parameters = content.get("tagslam_parameters") or {}
    return TagLayout(tuple(bodies), default, dict(parameters))


def _read_body(path: Path, name: str, body: dict[str, Any]) -> Body:
    is_static = body.get("is_static")
    if not isinstance(is_static, bool):
        raise FileError(path, f"{name}.is_static is {is_static!r}, expected true or false")
    size = body.get("default_tag_size")
    default_size = None if size is None else number(path, f"{name}.default_tag_size", size)
    pose = read_pose(path, f"{name}.pose", body["pose"]) if body.get("pose") is not None else None
    if body.get("type", "simple") == "board":
        if not isinstance(body.get("board"), dict):
            raise FileError(path, f"{name} is a board without 'board'")
        tags = _board_tags(path, f"{name}.board", body["board"])
    elif body.get("type", "simple") == "simple":
        tags = [_read_tag(path, name, tag, default_size) for tag in body.get("tags") or []]
    else:
        raise FileError(path, f"{name}.type is {body['type']!r}, expected simple or board")
    ids = [tag.id for tag in tags]
    if len(set(ids)) != len(ids):
        raise FileError(path, f"{name}.tags: an id occurs twice")
    return Body(name, is_static, pose if is_static else None, default_size, tuple(tags))


def _read_tag(path: Path, body: str, tag: Any, default_size: float | None) -> BodyTag:
    if not isinstance(tag, dict) or not isinstance(tag.get("id"), int) or isinstance(tag.get("id"), bool):
        raise FileError(path, f"{body}.tags: {tag!r} has no whole-number id")
    where = f"{body}.tags[{tag['id']}]"
    if "size" not in tag and default_size is None:
        raise FileError(path, f"{where} has no size, and {body} no default_tag_size")
    size = number(path, f"{where}.size", tag["size"]) if "size" in tag else default_size
    if size is None or size <= 0:
        raise FileError(path, f"{where}.size is {size}, expected a positive length")
    pose = tag.get("pose")
    if pose is None:
        return BodyTag(tag["id"], size, None)
    noise = [
        read_xyz(path, f"{where}.pose.{key}", pose[key]) if isinstance(pose, dict) and key in pose else None
        for key in ("position_noise", "rotation_noise")
    ]
    return BodyTag(tag["id"], size, read_pose(path, f"{where}.pose", pose), noise[0], noise[1])


def _board_tags(path: Path, where: str, board: dict[str, Any]) -> list[BodyTag]:
    keys = ("tag_start_id", "tag_size", "tag_spacing", "tag_rows", "tag_columns")
    missing = [key for key in keys if key not in board]
    if missing:
        raise FileError(path, f"{where} has no {', '.join(missing)}")
    start, size, spacing, rows, columns = (number(path, f"{where}.{key}", board[key]) for key in keys)
    T_tag0_body = read_pose(path, f"{where}.pose", board["pose"]) if board.get("pose") is not None else np.eye(4)
    noise = [
        np.full(3, number(path, f"{where}.{key}", board[key])) if key in board else None
        for key in ("tag_position_noise", "tag_rotation_noise")
    ]
    tags = []
    for row in range(int(rows)):
        for column in range(int(columns)):
            T = np.eye(4)
            T[:2, 3] = np.array([column, row]) * size * (1 + spacing)
            tag_id = int(start) + row * int(columns) + column
            tags.append(BodyTag(tag_id, size, transform_inv(T_tag0_body) @ T, noise[0], noise[1]))
    return tags


def write_tagslam(layout: TagLayout, path: str | Path) -> None:
    """Write `tagslam.yaml`. Boards are written as the tags they consist of."""
    bodies = []
    for body in layout.bodies:
        entry: dict[str, Any] = {"is_static": body.is_static, "type": "simple"}
        if body.default_tag_size is not None:
            entry["default_tag_size"] = float(body.default_tag_size)
        if body.T_map_body is not None:
            entry["pose"] = {**pose_mapping(body.T_map_body), **_noise_mapping(np.full(3, 1e-4), np.full(3, 1e-5))}
        if body.tags:
            entry["tags"] = [_tag_mapping(tag) for tag in body.tags]
        bodies.append({body.name: entry})
    content: dict[str, Any] = {"tagslam_parameters": layout.parameters} if layout.parameters else {}
    content["body_defaults"] = {"position_noise": 0.05, "rotation_noise": 0.01}
    if layout.default_body is not None:
        content["default_body"] = layout.default_body
    content["bodies"] = bodies
    Path(path).write_text(yaml.safe_dump(content, sort_keys=False), encoding="utf-8")


def _tag_mapping(tag: BodyTag) -> dict[str, Any]:
    entry: dict[str, Any] = {"id": int(tag.id), "size": float(tag.size)}
    if tag.T_body_tag is not None:
        entry["pose"] = {**pose_mapping(tag.T_body_tag), **_noise_mapping(tag.position_noise, tag.rotation_noise)}
    return entry


def _noise_mapping(position: Array | None, rotation: Array | None) -> dict[str, Any]:
    entries = {"position_noise": position, "rotation_noise": rotation}
    return {
        key: dict(zip("xyz", map(float, values), strict=True)) for key, values in entries.items() if values is not None
    }


def layout_of(model: ObjectModel, *, rigs: Sequence[str] = ("rig",)) -> TagLayout:
    """The scene of an object among fixed camera rigs that sit at the world's origin."""
    static = [Body(name, True, np.eye(4)) for name in rigs]
    noise = np.full(3, 1e-5)
    moving = [
        Body(
            name,
            False,
            tags=tuple(BodyTag(tag.id, tag.size, tag.T_body_tag, noise, noise) for tag in model.tags if tag.body == b),
        )
        for b, name in enumerate(model.body_names)
    ]
    return TagLayout((*static, *moving), parameters={"pixel_noise": 1.0, "minimum_viewing_angle": 12.0})


def object_tags(layout: TagLayout, body_names: Sequence[str]) -> tuple[Tag, ...]:
    """The tags of known pose on the named bodies of an object.

    A one-body object also takes the scene's only moving body with tags, whatever its name.

    Raises:
        ObjectError: no such body, or no tag of known pose on any.
    """
    bodies = [layout.body(name) for name in body_names]
    if len(body_names) == 1 and bodies[0] is None:
        moving = [body for body in layout.bodies if not body.is_static and body.tags]
        bodies = list(moving) if len(moving) == 1 else bodies
    tags = [
        Tag(tag.id, tag.size, b, tag.T_body_tag)
        for b, body in enumerate(bodies)
        if body is not None
        for tag in body.tags
        if tag.T_body_tag is not None
    ]
    if not tags:
        names = ", ".join(body.name for body in layout.bodies)
        raise ObjectError(f"no tag of known pose on {', '.join(body_names)} (bodies of the scene: {names})")
    return tuple(tags)
