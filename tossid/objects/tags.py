"""The AprilTags on an object's bodies, from a file in TagSLAM's form."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from tossid import budget
from tossid.errors import FileError, ObjectError, brief
from tossid.objects.model import Tag
from tossid.yaml_files import check_keys, number, read_pose, read_yaml

TAG_KEYS = ("id", "size", "pose", "family")
BODY_KEYS = (
    *("is_static", "type", "pose", "tags", "board", "default_tag_size", "tag_family", "ignore_tags"),
    *("override_tag_position_noise", "override_tag_rotation_noise"),
)
TAGSLAMS_BODY_KEYS = (
    *("max_hamming_distance", "T_body_odom", "odom_frame_id", "odom_topic", "publish_covariance", "frame_id"),
    *("odom_translation_noise", "odom_rotation_noise", "odom_acceleration", "odom_angular_acceleration"),
    *("fake_odom_translation_noise", "fake_odom_rotation_noise"),
    *(f"odom_{of}acceleration_noise_{end}" for of in ("", "angular_") for end in ("min", "max")),
    *("is_default_body", "staggered_board"),
)
"""What TagSLAM takes in of a body beside `BODY_KEYS`, for its odometry and what it publishes."""


def read_tags(path: Path, body_names: Sequence[str]) -> tuple[Tag, ...]:
    """The tags of known pose on the bodies of an object.

    Args:
        path: A `tagslam.yaml`. What it says of cameras, boards and measurements is not read here, see
            `tossid.vision.setup.tagslam`.
        body_names: The object's bodies. An object of one body also takes the file's only moving body with tags.

    Raises:
        FileError: The file cannot be read, or a tag has no id, size or pose that makes sense.
        ObjectError: There is no tag of known pose on any of the bodies.
    """
    entries = read_yaml(path).get("bodies")
    if not isinstance(entries, list):
        raise FileError(path, "has no list 'bodies'")
    bodies: dict[str, dict[str, Any]] = {}
    for entry in entries:
        if not isinstance(entry, dict) or not all(isinstance(body, dict) for body in entry.values()):
            raise FileError(path, f"bodies: {brief(entry)} is not one name with its values")
        bodies |= {str(name): body for name, body in entry.items()}
    for name, body in bodies.items():
        check_keys(path, name, body, BODY_KEYS, unused=TAGSLAMS_BODY_KEYS, instead={"tag_size": "default_tag_size"})
    claimed = sum(len(body["tags"]) for body in bodies.values() if isinstance(body.get("tags"), list))
    budget.check_claim(path, "tags", claimed, budget.limits().tags)
    moving = [body for body in bodies.values() if body.get("is_static") is False and body.get("tags")]
    if len(body_names) == 1 and len(moving) == 1 and body_names[0] not in bodies:
        bodies[body_names[0]] = moving[0]
    tags = [
        _read_tag(path, name, tag, bodies[name], b)
        for b, name in enumerate(body_names)
        if name in bodies
        for tag in _listed(path, name, bodies[name])
        if tag.get("pose") is not None
    ]
    if not tags:
        raise ObjectError(f"{path}: no tag of known pose on {', '.join(body_names)} (bodies: {', '.join(bodies)})")
    ids = [tag.id for tag in tags]
    if len(set(ids)) < len(ids):
        raise FileError(path, "bodies: a tag is listed twice; an id can be on one body once")
    return tuple(tags)


def _listed(path: Path, name: str, body: dict[str, Any]) -> list[dict[str, Any]]:
    tags = body.get("tags") or []
    if not isinstance(tags, list) or not all(isinstance(tag, dict) for tag in tags):
        raise FileError(path, f"{name}.tags is {brief(tags)}, expected a list of tags")
    return tags


def _read_tag(path: Path, name: str, tag: dict[str, Any], body: dict[str, Any], b: int) -> Tag:
    if not isinstance(tag.get("id"), int) or isinstance(tag["id"], bool):
        raise FileError(path, f"{name}.tags: {brief(tag)} has no whole-number id")
    where = f"{name}.tags[{tag['id']}]"
    check_keys(path, where, tag, TAG_KEYS, unused=("bits",))
    size = number(path, f"{where}.size", tag.get("size", body.get("default_tag_size")))
    if size <= 0:
        raise FileError(path, f"{where}.size is {size}, expected a positive length")
    return Tag(tag["id"], size, b, read_pose(path, f"{where}.pose", tag["pose"]))
