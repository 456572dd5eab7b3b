"""The object of a recording: `object.yaml`, and its model, in the recording's folder."""

from __future__ import annotations

import os
from dataclasses import asdict, fields
from pathlib import Path
from typing import Any

import yaml

from tossid.errors import ConfigError, FileError, ObjectError, brief
from tossid.objects.model import ObjectModel
from tossid.objects.references import check_model_file, inside
from tossid.settings.objects import ObjectSettings
from tossid.yaml_files import number, read_yaml

_LONGEST_NAME = 255
"""Bytes of a file's name."""


def write_object(model: ObjectModel, mjcf: str, folder: Path) -> None:
    """Leave an object beside a recording: its bodies in object.xml, its settings in object.yaml.

    Args:
        model: The object; its tags are those of the recording's tagslam.yaml.
        mjcf: Its bodies as MJCF, as `tossid.store.text_of_model` gives them.
        folder: The recording's folder.
    """
    settings = ObjectSettings(
        name=model.name,
        path=Path("object.xml"),
        friction=model.friction,
        restitution=model.restitution,
        width=model.width,
        tags=Path("tagslam.yaml") if model.tags else None,
    )
    values = {name: str(value) if isinstance(value, Path) else value for name, value in asdict(settings).items()}
    (folder / "object.xml").write_text(mjcf, encoding="utf-8")
    (folder / "object.yaml").write_text(yaml.safe_dump(values, sort_keys=False))


def recorded_object(folder: Path) -> ObjectSettings | None:
    """The object that `write_object` left in a folder, None if there is none.

    Raises:
        FileError: The folder's object.yaml does not describe an object, or names files outside the folder.
    """
    file = folder / "object.yaml"
    if not file.exists():
        return None
    values = read_yaml(file)
    if strange := sorted(set(map(str, values)) - {field.name for field in fields(ObjectSettings)}):
        raise FileError(file, f"does not describe an object: {strange[0]} is no setting of one")
    try:
        settings = ObjectSettings(
            name=_text(file, "name", values.get("name")),
            path=_own_file(file, "path", values.get("path")),
            friction=number(file, "friction", values.get("friction")),
            restitution=number(file, "restitution", values.get("restitution")),
            width=None if values.get("width") is None else number(file, "width", values["width"]),
            tags=None if values.get("tags") is None else _own_file(file, "tags", values["tags"]),
        )
    except ConfigError as error:
        raise FileError(file, f"does not describe an object: {error}") from error
    if settings.path.exists():
        check_model_file(settings.path, own_folder=folder)
    return settings


def _own_file(file: Path, key: str, value: Any) -> Path:
    """A file that object.yaml names: one in its own folder."""
    try:
        return inside(file.parent, _text(file, key, value))
    except ObjectError as error:
        raise FileError(file, f"{key}: {error}") from error


def _text(file: Path, key: str, value: Any) -> str:
    """A name that a file could have."""
    usable = isinstance(value, str) and value and "\0" not in value
    if not usable or any(len(os.fsencode(part)) > _LONGEST_NAME for part in Path(value).parts):
        raise FileError(file, f"does not describe an object: {key} is {brief(value)}, expected text")
    return str(value)
